"""A search for counterexamples to the bounds on which the engine's exactness rests: `python -m tests.bounds --cases N`.

Each bound is proved in the docstring of the module that relies on it; docs/internals/bounds.md lists all of them. Here the
project's own functions compute in float32 what a bound is about, and NumPy computes it in float64, whose roundings are 2^-29 of
those that are looked for. What comes out is a ratio: the error that was found over the error that the bound allows. A ratio
above 1 is a counterexample. The largest ratio shows how much of a constant is slack.

* `inputs`: rays, triangles and boxes, random and adversarial: equal exponents, mantissas next to a power of two, needles, rays
  at edges and vertices, scales from 2^-100 to 2^100, subnormal numbers.
* `box_bounds`: the slab test, also for rays and boxes that were rounded, and the box test of interleaved walks.
* `triangle_bounds`: the watertight test, edge functions, vertex culling, offsets of spawned rays, points on planes, clipped
  triangles.
* `search`: the loop over batches, and the table of all bounds.
"""
