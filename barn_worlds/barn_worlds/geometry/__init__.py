"""Shapes seen from above, and their distances."""
