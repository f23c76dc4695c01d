"""Whether results hold: rows computed again, commands driven again, submissions."""
