"""Triangle tests under measurement: isolated from trees, their operations and exits counted."""
