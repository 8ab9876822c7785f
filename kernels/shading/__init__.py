"""Pictures: what happens to a pixel between its camera ray and its colour, one step a file.

    camera.py     pixels -> rays
    normals.py    a mesh -> smooth normals at the corners of its triangles
    surface.py    hits -> points, normals and colours; rays to the light
    ambient.py    points -> rays into the hemisphere; how many of them leave the scene
    film.py       light and openness -> linear colour, summed over a pixel's samples; linear -> display colour
    sampling.py   well spread random numbers

**Contract.** Every step is a kernel over the pixels of a tile that writes what belongs to its own pixel only, and its
random numbers follow from the pixel's place in the picture: neither tiles, threads nor the device show in the result.
"""
