"""Messages of ROS 2 as bytes, without ROS: the suite's topics, encoders and decoders.

Nodes publish the same bytes that direct trials record, because both come from here.
"""
