"""Contacts of the robot with obstacles, which PyBullet computes."""
