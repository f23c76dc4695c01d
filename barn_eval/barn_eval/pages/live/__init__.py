"""Show runs and trials while they go on."""
