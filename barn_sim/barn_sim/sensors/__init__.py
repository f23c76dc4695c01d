"""What a robot measures."""
