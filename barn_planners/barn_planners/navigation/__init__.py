"""What planners share: the loop around a controller, recovery and checks."""
