"""Bags: what a trial records, and how a recording is read."""
