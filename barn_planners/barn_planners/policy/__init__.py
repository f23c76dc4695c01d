"""Learned policies: files, observations, actions and a planner."""
