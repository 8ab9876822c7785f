"""Boxes around the rays of a stream, from origin to end, which tell that most short rays meet nothing.

**Problem.** Most of the short rays in an open scene, such as those of ambient occlusion, meet no child of the root. Before that
is known, each of them is prepared, with three divisions, and tested against all children. The few rays of a group that stay
then leave most lanes idle.

**Idea.** Compare the box around each ray with the boxes of the children. Both are rounded to the cells of a grid, so that 16
rays are compared at a time as 16-bit numbers: a saturated difference for each of six planes, whose sign is that of a gap. Rays
whose box meets no child are done. The others wait until there are 16 of them, which are then made relative to the scene's
centre, checked, prepared, tested and stored together.

Long rays meet most boxes. If more than `MANY` rays of a group of 16 stay, the next `PAUSE` groups are not compared, nor do they
wait (`RootGrid` of kernels/native/stream_root.h).

**Exactness.** A hit is a point origin + t direction within the slack of its triangle's box. The children's boxes are widened
for that, for the rounding of the rays' ends (as in `wrt.kernels.traversal.packet.rays.reversed_bounds`), and for rounding to
cells. Rays that end so far away that this does not suffice meet every box. On CUDA boxes are not compared.

Figures: notebooks/records/2026-11-26-joined-packets.md, notebooks/records/2026-11-26-masked-stores.md.
"""

from wrt.kernels.simd.boxes import SLACK
from wrt.kernels.traversal.packet.rays.reversed_bounds import ENDS_ERROR
from wrt.kernels.traversal.stream.stream_kernel import LIST_LANES

ROWS = 9
"""Numbers of a waiting ray: origin, direction, number, t_min, t."""

ROOM = 2 * LIST_LANES
"""Waiting rays: less than a group, and the next group."""

ERROR = 3.0 * SLACK + ENDS_ERROR
"""By which the box around a ray must be widened, as a fraction of the sum of the largest coordinates of ray and scene."""

GRID = 8
"""Floats that describe the grid: cells per unit of length; what is added to x, y and z in cells; the largest coordinate of a
box around a ray for which `MARGIN` suffices; the scene's centre, from which coordinates count, as floats."""


def box_memory(width: int) -> int:
    """Floats of memory: waiting rays, the grid, and six planes of each child, in cells, once for each lane."""
    return ROWS * ROOM + GRID + 3 * width * LIST_LANES
