"""What a query reads and writes: the frozen state of a scene, the cache beside it, and answers in device memory."""
