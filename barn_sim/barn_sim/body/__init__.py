"""The robot's body, what acts on it, and what it may touch."""
