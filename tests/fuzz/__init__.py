"""Fuzzing: meshes of raw bit patterns, rays against brute force, and mutated files, in processes that may crash.

    python -m tests.fuzz --minutes 5                    all four, a process for each core
    python -m tests.fuzz --minutes 60 --what meshes --seed 7
    python -m tests.fuzz --replay tests/fuzz/corpus/*.npz

* `meshes` (`building`): boxes and triangles that passed no check, of any bits at all, go to every builder, refit and refill.
  Every Warp array lies against a page that nobody may touch (`guards`): an index that leads out of it ends the process.
* `rays` (`tracing`): a mesh is refused with a ValueError, or every tree answers as brute force does, to the bit.
* `files` (`files`): a damaged file is refused with a clear error, or read; no crash, no hang, no huge allocation.
* `loaders` (`loaders`): the same for the readers of mesh files alone, with materials and images, in memory: thousands a second.

A case follows from the seed and its number alone. What fails is kept in a folder as a small file (`cases`), which the tests
replay.
"""
