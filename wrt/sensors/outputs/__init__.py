"""What sensors give: layers of scans and images, made when they are read, and tables of them."""
