"""Obstacles that move, and walls."""
