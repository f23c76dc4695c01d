"""Experiments: which trials are run, how they run, and where their results are stored."""
