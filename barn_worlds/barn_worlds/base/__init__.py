"""What everything else is built on: configuration, errors, types, files."""
