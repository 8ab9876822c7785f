"""Coherence detection: whether neighbouring rays of a batch are similar, and whether the rays are the pixels of a picture.

The result affects only speed. The host runs the detection before each call, with cold caches; one kernel that reads a few
hundred rays is several times as fast as NumPy code (notebooks/records/2026-11-22-launches.md).
"""

import warp as wp

from wrt.kernels.runtime.options import exact_kernel

PAIRS = wp.constant(64)
"""Number of pairs of neighbouring rays that are compared; must be even."""

MIN_COSINE = wp.constant(wp.float64(0.966))
"""Cosine of the greatest angle between similar directions, about 15 degrees."""

MIN_ROWS = wp.constant(8)
"""Least number of rows and of columns of a batch that is recognised as a picture."""

MAX_COLUMNS = wp.constant(1 << 13)
"""Greatest number of pixels in a row that is recognised in a flat list."""

ROW_END_FACTOR = wp.constant(4.0)
"""A difference of neighbouring directions that is this many times that of the first two rays ends a row."""

BLOCK = wp.constant(1 << 14)
"""Words that an item of `compare_neighbours` compares."""

COHERENT, SCATTERED, COLUMNS = 0, 1, 2
"""Indices of the results."""


@wp.func
def manhattan_distance(a: wp.vec3, b: wp.vec3):
    """Sum of the absolute differences along the axes."""
    d = wp.abs(wp.vec3d(b) - wp.vec3d(a))
    return d[0] + d[1] + d[2]


@wp.func
def is_similar(a: wp.vec3, b: wp.vec3):
    """Whether two directions differ by a small angle; false for a zero or NaN direction."""
    one, other = wp.vec3d(a), wp.vec3d(b)
    return wp.dot(one, other) / wp.sqrt(wp.dot(one, one) * wp.dot(other, other)) > MIN_COSINE


@wp.func
def pair_at(i: int, count: int):
    """Number of the first ray of pair `i`; the pairs are spread evenly over the batch."""
    step = wp.float64(count - 2) / wp.float64(PAIRS - 1)
    return wp.where(i == PAIRS - 1, count - 2, int(wp.float64(i) * step))


@wp.func
def median_distance(origins: wp.array(dtype=wp.vec3)):
    """Median distance between origins that are far apart in the batch; NaN if a distance is NaN."""
    distances = wp.zeros(shape=PAIRS, dtype=wp.float64)
    count = origins.shape[0]
    for i in range(PAIRS):
        distance = manhattan_distance(origins[pair_at(i, count)], origins[pair_at(PAIRS - 1 - i, count)])
        if wp.isnan(distance):
            return distance
        at = int(i)
        while at > 0 and distances[wp.max(at - 1, 0)] > distance:
            distances[at] = distances[at - 1]
            at -= 1
        distances[at] = distance
    return (distances[PAIRS // 2 - 1] + distances[PAIRS // 2]) / wp.float64(2.0)


@wp.func
def largest_change(a: wp.vec3, b: wp.vec3):
    """Largest absolute difference of a component."""
    return wp.max(wp.abs(b - a))


@wp.func
def count_columns(directions: wp.array(dtype=wp.vec3)):
    """Number of columns of the picture; 0 if the batch is not a picture.

    A row ends where directions jump; each row must begin close to the start of the row before.
    """
    count = directions.shape[0]
    limit = ROW_END_FACTOR * largest_change(directions[0], directions[1])
    columns, max_columns = int(1), wp.min(MAX_COLUMNS, count - 1)
    while columns <= max_columns and not largest_change(directions[columns - 1], directions[columns]) > limit:
        columns += 1
    if columns > max_columns or columns < MIN_ROWS or count % columns != 0 or count < MIN_ROWS * columns:
        return 0
    row = int(columns)
    while row < count:
        if not largest_change(directions[row - columns], directions[row]) < limit:
            return 0
        row += columns
    return columns


@exact_kernel
def measure_coherence(
    first: int,
    origins: wp.array(dtype=wp.vec3),
    directions: wp.array(dtype=wp.vec3),
    sampled: int,
    listed: int,
    results: wp.array(dtype=int),
):
    """Writes the results for a batch: 0 or 1 for coherent and scattered, and the number of columns (0: no picture).

    Pairs are compared only if `sampled` is not 0, columns are searched only if `listed` is not 0.
    """
    count, similar_pairs, near_pairs = directions.shape[0], int(0), int(0)
    origin_per_ray = origins.shape[0] == count
    if sampled != 0:
        limit = wp.float64(0.0)
        if origin_per_ray:
            limit = wp.float64(0.1) * median_distance(origins)
        for i in range(PAIRS):
            ray = pair_at(i, count)
            a, b = wp.where(origin_per_ray, ray, 0), wp.where(origin_per_ray, ray + 1, 0)
            close = not origin_per_ray or manhattan_distance(origins[a], origins[b]) <= limit
            near_pairs += wp.where(close, 1, 0)
            similar_pairs += wp.where(close and is_similar(directions[ray], directions[ray + 1]), 1, 0)
    results[COHERENT] = wp.where(sampled == 0 or 2 * similar_pairs > PAIRS, 1, 0)
    results[SCATTERED] = wp.where(sampled != 0 and 2 * near_pairs <= PAIRS, 1, 0)
    results[COLUMNS] = int(0)
    if listed != 0:
        results[COLUMNS] = count_columns(directions)


@wp.func_native("""
    int difference = 0;
    for (int i = begin; i < end; ++i) difference |= words.data[i] ^ words.data[i - step];
    return difference;
""")
def differences(words: wp.array(dtype=int), begin: int, end: int, step: int) -> int:
    """The bits in which a word begin .. end - 1 differs from the one `step` places before it.

    Native, because Warp's loops are not compiled to vector instructions; without a branch, so that this one is.
    """


@exact_kernel
def compare_neighbours(first: int, words: wp.array(dtype=int), step: int, found: wp.array(dtype=int)):
    """Writes 1 to `found[0]` if one of an item's `BLOCK` words differs from the word `step` places before it."""
    if found[0] != 0:
        return
    begin = step + (first + wp.tid()) * BLOCK
    if differences(words, begin, wp.min(begin + BLOCK, words.shape[0]), step) != 0:
        found[0] = 1
