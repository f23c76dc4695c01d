"""Reading and making messages of sensors, as sensor_msgs_py offers it."""
