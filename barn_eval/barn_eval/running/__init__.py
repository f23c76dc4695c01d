"""Runs: their request, their trials on workers, and trials in one process."""
