"""The loop around a local planner, as in move_base."""
