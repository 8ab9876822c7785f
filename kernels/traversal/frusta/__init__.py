"""Several small frusta that walk a tree together: eye rays, and other rays from one point."""
