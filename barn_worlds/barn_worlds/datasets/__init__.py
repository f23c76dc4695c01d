"""Data sets of worlds: opening shipped and own ones, and generating new ones."""
