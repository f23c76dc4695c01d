"""Whether a robot drives as theory says."""
