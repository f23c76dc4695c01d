"""A trial seen again from its bag alone."""
