"""Training in `barn/Jackal-v0`: batches and policy files for Stable-Baselines3, and worlds from easy to difficult."""
