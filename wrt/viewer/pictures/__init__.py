"""Pictures of the viewer: light, layers of hits, and the cost of rays."""
