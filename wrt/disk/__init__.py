"""Scenes larger than memory: parts on disk, each with its tree, loaded on demand while rays wait for them."""
