"""Trials over ROS as processes under supervision; nothing in here knows rclpy."""
