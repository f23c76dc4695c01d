"""Reports and leaderboards."""
