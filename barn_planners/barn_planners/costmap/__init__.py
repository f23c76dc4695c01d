"""Costmaps as costmap_2d makes them."""
