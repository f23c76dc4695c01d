"""Planners that predict moving obstacles, and the tracker that finds them."""
