"""What a query knows before it is planned: its kind, the frozen state of the scene, and the cache beside it."""
