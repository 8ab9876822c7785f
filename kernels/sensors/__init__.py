"""Device code of sensors: random numbers, poses over time, beams of a lidar and their returns, lenses of cameras."""
