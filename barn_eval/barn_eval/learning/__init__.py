"""Learning: the Gymnasium environment, curricula and the difficulty model's data."""
