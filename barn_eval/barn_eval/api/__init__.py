"""What Python users and the commands call: runs, results, worlds, robots, the difficulty model."""
