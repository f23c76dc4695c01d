"""Bags: what a trial records, and how a recording is read."""

BAGS = "bags"  # folder of them among the results of a run
