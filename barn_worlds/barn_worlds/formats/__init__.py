"""Reading and writing worlds in each format, whoever the author of a file."""
