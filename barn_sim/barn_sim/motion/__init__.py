"""How robots move from tick to tick, one by itself or many at once."""
