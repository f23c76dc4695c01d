"""Replays of trials: page, picture, GIF, film, overlay."""
