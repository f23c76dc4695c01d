"""Planners that predict what moves: `tracker` says what does, `planners` are the planners."""
