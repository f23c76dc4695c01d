"""Replay trials as a page, picture, GIF or film."""
