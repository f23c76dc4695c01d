"""Training in `barn/Jackal-v0`: Stable-Baselines3, and a curriculum of worlds."""
