"""Follow the gap, a simple baseline."""
