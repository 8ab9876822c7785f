"""Light sources: their tables on the device, and points and directions sampled on them."""
