"""Pictures: cameras, shading, and image files."""
