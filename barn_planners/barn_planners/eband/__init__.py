"""Elastic bands."""
