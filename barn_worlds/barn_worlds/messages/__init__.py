"""Messages of ROS 2 as bytes, without ROS: the suite's topics, and its types to and from messages.

Nodes publish, and direct trials record, the same bytes because both come from here.
"""
