"""Configuration, errors, types and files: what the rest of the suite builds on."""
