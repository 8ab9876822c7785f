"""Trees of trees: instances, and clusters with fuzzy boxes."""
