"""Contacts with obstacles, which PyBullet computes: what may be touched, and the bodies of what is near."""
