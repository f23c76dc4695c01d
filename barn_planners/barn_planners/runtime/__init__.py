"""What runs a planner: sessions, synchronised inputs, messages."""
