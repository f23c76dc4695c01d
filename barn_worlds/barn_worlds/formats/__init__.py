"""Reading and writing worlds in the formats of others; nothing that is read is trusted."""
