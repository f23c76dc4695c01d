"""Pictures of worlds and robots."""
