"""Planners that predict what moves."""
