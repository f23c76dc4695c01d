"""Learning: the Gymnasium environment, one and a batch."""
