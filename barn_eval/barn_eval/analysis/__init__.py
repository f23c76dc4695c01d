"""Analyze results: statistics, measures, comparisons and rankings."""
