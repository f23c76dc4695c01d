"""Learned policies: their files, observations and actions, and the planner that uses them."""
