"""What triangle tests share: their contract, records in blocks, and lane loops."""
