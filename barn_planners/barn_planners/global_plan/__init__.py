"""The global plan."""
