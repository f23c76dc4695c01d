"""Reading and writing worlds in other formats. Files are not trusted."""
