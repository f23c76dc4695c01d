"""Costmaps by the rules of costmap_2d: obstacles that a lidar marks, inflated."""
