"""Data sets of worlds: opens shipped ones and yours, and generates new ones."""
