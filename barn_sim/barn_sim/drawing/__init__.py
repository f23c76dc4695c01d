"""Pictures of a trial in three dimensions."""
