"""Paths in tiles: path tracing of some thousand samples from the camera to the end.

    path_tiles.py   the kernels of a tile: the step, the order of the rays that follow, light past shadow rays; the step for W
                    rays in lanes: matte surfaces, mirrors, smooth glass, and rays that end
    last_rays.py    which rays of the last generation need the closest hit

What a step sends out is appended: paths that go on to a second queue, shadow rays that may bring light to a list. Rays that are
not there are neither written nor loaded by a traversal, and the vectors and streams of the others are full.
"""
