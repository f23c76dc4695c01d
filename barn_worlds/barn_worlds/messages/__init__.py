"""Messages of ROS 2 as bytes, without ROS: the topics of the suite, and its types to and from their messages.

What nodes publish and what bags hold of a direct trial are the same bytes because both come from here.
"""
