"""Trees of rays in tiles: Whitted's and distribution ray tracing of some hundred samples from the camera to the end.

    tree_tiles.py     the kernels of a tile: the step, and sums of light; the step for W rays in lanes: mirrors, smooth glass,
                      and rays that end
    tile_memories.py  the memory of a tile, its camera rays, and the loop over tiles; for paths, too

A sample's tree has as many rays in a generation as its branches, so the memory of a tile may run out. Its samples are then
done in two halves.
"""
