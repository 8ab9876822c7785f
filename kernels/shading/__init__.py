"""Shading: the steps from a camera ray to the colour of its pixel, one file per step.

    pixel_rays.py     pixels -> rays
    normals.py        a mesh -> smooth normals at the corners of its triangles
    surface.py        hits -> points, normals and colours; rays to the light
    shading_point.py  hits -> points to shade by materials
    ambient.py        points -> rays into the hemisphere, and the number of them that leave the scene
    film.py           light and visibility -> linear colour, summed over a pixel's samples; linear -> display colour
    false_color.py    values of pixels -> colours
    sampling.py       low-discrepancy random numbers
    bsdf/             materials, and how they scatter
    emitters/         lights and skies
    wavefront/        paths and trees of rays by generations
    paths/            paths in tiles
    ray_trees/        trees of rays in tiles

**Contract.** Every step is a kernel over the pixels of a tile and writes only the data of its own pixel. Its random numbers
follow from the pixel's position in the image. So the result does not depend on tiles, threads or the device.
"""
