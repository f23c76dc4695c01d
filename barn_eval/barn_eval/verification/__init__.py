"""Check whether results hold: recompute rows, drive commands again, verify files."""
