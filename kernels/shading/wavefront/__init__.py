"""Rays by generations: camera rays, one step from a generation to the next, and the queues in between.

    pixel_samples.py  random numbers of a pixel's samples, one dimension an effect
    camera_rays.py    pixels -> rays, through a filter and a lens
    ray_at_hit.py     a ray with what it hit, and the key of its random numbers
    path_step.py      one step of path tracing (in tiles: `wrt.kernels.shading.paths`)
    path_step_simd.py     the same for W rays in lanes, on matte surfaces, mirrors and smooth glass
    lane_code.py      C++ around calls of what is in lanes
    scene_light.py    the scene in a step, light that may arrive, and the passage through a boundary
    shading_streams.py  rays filtered by what they hit, and one code for each stream
    texture_demand.py the tiles of images that rays need
    tree_step.py      one step of Whitted's and of distribution ray tracing (in tiles: `wrt.kernels.shading.ray_trees`)
    ray_queue.py      the rays of a generation, and their compaction: count, scan, fill
    picture.py        radiance of samples -> the film, its noise, and layers

**Contract.** A step is a kernel over the rays of a generation. What it writes depends on its own ray alone; random numbers
follow from pixel, sample and dimension. So neither threads nor the size of a wave show in a picture.
"""
