"""Files of sensors' measurements: tables of points, LAS, and ROS 2 bags."""
