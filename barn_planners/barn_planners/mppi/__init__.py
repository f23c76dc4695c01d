"""Model predictive path integral control (MPPI), after Nav2's controller."""
