"""The watertight test of Woop, Benthin and Wald (2013), for rays, packets and streams."""
