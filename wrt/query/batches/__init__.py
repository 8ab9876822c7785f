"""Batches of any size, block by block: where rays come from, who answers a block, what becomes of the answers."""
