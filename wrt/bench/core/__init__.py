"""What all measurements share: the rays, timing in turns, agreement, results, tables and pictures."""
