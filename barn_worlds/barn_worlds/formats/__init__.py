"""Reads and writes worlds in each format; files may come from anyone."""
