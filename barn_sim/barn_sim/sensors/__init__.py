"""What a robot measures, and pictures of it."""
