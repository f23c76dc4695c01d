"""Training in `barn/Jackal-v0` with Stable-Baselines3, from easy to difficult worlds."""
