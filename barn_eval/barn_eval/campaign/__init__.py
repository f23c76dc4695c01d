"""Campaigns: many trials on many workers, each recorded once, whatever is killed in between."""
