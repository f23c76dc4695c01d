"""Campaigns and trials while they run."""
