"""Planners that predict moving obstacles: `tracker` finds them, `planners` avoid them."""
