"""Reports, replays and rankings as pages and pictures."""
