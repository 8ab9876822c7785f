"""Point clouds that rays meet: `wrt.sensors.PointCloud`, its tree, and its state."""
