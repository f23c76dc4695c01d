"""Studies that drive trials: tuning, A/B tests, speed, and the paper's results."""
