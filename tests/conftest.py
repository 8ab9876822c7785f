"""Fixtures: the devices found here, meshes to test on, and rays of every kind."""

from __future__ import annotations

import argparse
import gc
import os
from collections import defaultdict
from collections.abc import Iterator
from itertools import groupby
from pathlib import Path

import numpy as np
import pytest
import warp as wp

wp.config.log_level = wp.LOG_WARNING
AS_USERS = "WRT_TESTS_AS_USERS"
"""With 1 in this variable, kernels are compiled as users' are."""

if os.environ.get(AS_USERS) != "1":
    wp.config.cpu_compiler_flags = "-march=native -mllvm=-inline-threshold=1000 -O1"
"""Most of the time of the tests goes into compiling kernels. Users' have -O2 and inline nine times as much (9000): kernels
then run faster, which is not asked here. CPU seconds on a Zen CPU with AVX2, three packet kernels, three of builds, and
brute force: 14.9 with -O2 and 1000, 14.4 with 225, 10.3 with -O1 and 1000, 4.1 with -O0. The bits are the same;
`test_bits.py` asks for them of the kernels that users run first, compiled as theirs are. Processes that tests start
compile as users do, unless they are given these flags."""

os.environ.setdefault("WRT_SHOW_COMPILING", "0")
"""What processes that tests start say on stderr must not depend on what is in the kernel cache."""

wp.init()

import wrt  # noqa: E402
from wrt import scenes  # noqa: E402
from wrt.builders.bvh import BVH_BUILDERS  # noqa: E402
from wrt.builders.kdtree import KDTREE_BUILDERS  # noqa: E402
from wrt.kernels.compilation.cores import available_cores  # noqa: E402
from wrt.kernels.on_demand import OnDemand  # noqa: E402
from wrt.kernels.traversal import TRAVERSALS  # noqa: E402
from wrt.kernels.traversal.mailbox import MAILBOXES  # noqa: E402
from wrt.kernels.traversal.packet import CULLINGS  # noqa: E402
from wrt.kernels.triangle import CLASSIC_TESTS  # noqa: E402

if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", 0)):
    os.environ.setdefault("WRT_COMPILE_JOBS", str(max(available_cores() // workers, 1)))
"""Processes that run tests side by side keep the cores busy, and every thread that compiles parses Warp's header (2 s).
Those that tests start inherit this."""

MODELS = Path(__file__).resolve().parents[2] / "shared" / "models"
ENGINE_TESTS = ("woop", "moeller_trumbore", "komatsu")
"""Triangle tests on which everything around them is tested: by hand, by steps, and with an origin that must be shared. What
the engine does with a test is the same for all others; `test_triangle_tests.py` shows that they fit in."""

OTHER_WAYS_TO_PACKETS = ("repacked_packet", "multi_frusta", "mlrta", "aepsa", "omnidirectional", "queued")
"""Traversals that meet leaves by the steps of "packet" (`wrt.kernels.traversal.packet.core.packet_kernel`), or of "single":
what they do with one triangle test, and with an origin that must be shared, is the same for all."""

CLASSICS = {
    *CLASSIC_TESTS,
    *(name for name, way in TRAVERSALS.items() if any(isinstance(make, OnDemand) for make in way.kernels.values())),
    *(name for name, one in CULLINGS.items() if any(isinstance(value, OnDemand) for value in vars(one).values())),
    *(name for name, one in MAILBOXES.items() if isinstance(one.filter, OnDemand)),
    *(name for table in (KDTREE_BUILDERS, BVH_BUILDERS) for name, one in table.items() if isinstance(one.build, OnDemand)),
} - {"none"}
"""Algorithms of kernels/classics and builders/classics. "none" is a key of several tables."""


SLOW = frozenset((Path(__file__).with_name("slow.txt")).read_text().split())
"""Files whose tests take more than some 6 s of a core even when all kernels are compiled."""

ASKED_FOR = ("exhaustive", "notebooks")
"""Markers of tests that run only where `-m` names them."""

LONGEST = "tests/pages/test_notebooks.py::test_notebook["
"""How the names of the tests that take longest begin."""


def pytest_addoption(parser: pytest.Parser) -> None:
    text = "of the chosen cases of each test one in N, but at least one; N turns that follow each other draw all"
    parser.addoption("--sample", metavar="N:TURN", type=as_sample, help=text)


def as_sample(text: str) -> tuple[int, int]:
    """The number and the turn of `--sample`.

    Raises:
        ArgumentTypeError: not two whole numbers, or the first is none of at least 1.
    """
    number, _, turn = text.partition(":")
    if not number.isdecimal() or int(number) < 1 or not turn.isdecimal():
        raise argparse.ArgumentTypeError(f"{text!r} is not N:TURN, as 3:1042; N is at least 1")
    return int(number), int(turn)


@pytest.hookimpl(wrapper=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> Iterator[None]:
    """Marks the tests that have a classic as a parameter, those of studies, and those of slow files; files about classics alone
    mark themselves. Leaves out what is marked with a name of `ASKED_FOR`, unless `-m` has that, and what is not in the sample.
    Where several processes run tests, notebooks come first: the last, of a minute, would keep one busy after all others."""
    for file, own in groupby(items, lambda item: item.nodeid.partition("::")[0]):
        names = ["slow"] * (file in SLOW) + ["studies"] * file.startswith("tests/studies/")
        for item in own:
            for name in names:
                item.add_marker(name)
            given = item.callspec.params.values() if hasattr(item, "callspec") else ()
            if any(isinstance(one, str) and one in CLASSICS for one in given):
                item.add_marker("classics")
    left_out = [name for name in ASKED_FOR if name not in config.option.markexpr]
    items[:] = [item for item in items if not any(name in item.keywords for name in left_out)]
    if workers:
        items.sort(key=lambda item: not item.nodeid.startswith(LONGEST))
    yield
    if config.option.sample:
        chosen = sample(items, *config.option.sample)
        kept = {*chosen}
        config.hook.pytest_deselected(items=[item for item in items if item not in kept])
        items[:] = chosen


def sample(items: list[pytest.Item], number: int, turn: int) -> list[pytest.Item]:
    """One in `number` of the cases of each test, and at least one: others in each of `number` turns, all in all of these."""
    cases = defaultdict(list)
    for item in items:
        cases[item.nodeid.partition("[")[0]].append(item)
    kept = {one for own in cases.values() for one in (own[turn % number :: number] or [own[turn % len(own)]])}
    return [item for item in items if item in kept]


DEVICES = ["cpu", *(str(device) for device in wp.get_cuda_devices())]


@pytest.fixture(autouse=True, scope="module")
def frozen() -> None:
    """What earlier files left, kernels above all, is not scanned again at every garbage collection. Studies collect before each
    round, which took longer than what they measure in tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(params=DEVICES)
def device(request: pytest.FixtureRequest) -> str:
    """Every device found: the CPU always, CUDA where there is one."""
    return request.param


def load_model(name: str) -> wrt.TriangleMesh:
    """A measured model; the test is skipped where the models are not at hand."""
    path = MODELS / name
    if not path.exists():
        pytest.skip(f"the model {name} is not at hand beside the checkout")
    return wrt.TriangleMesh.load(path)


@pytest.fixture(scope="session")
def bunny() -> wrt.TriangleMesh:
    """The Stanford bunny, 69,630 triangles."""
    return load_model("bunny.ply")


SCENES = {
    "teapot": lambda: scenes.build("teapot", level=4),
    "random_triangles": lambda: scenes.build("random_triangles", count=700, size=0.4, seed=3),
    "stadium": lambda: scenes.build("teapot_in_stadium", level=3),
    "atrium": lambda: scenes.build("atrium", bays=(3, 2), detail=3),
    "wood": lambda: scenes.build("wood", trees=3),
    "grid": lambda: snapped_soup(600, seed=5),
    "degenerate": lambda: degenerate_soup(),
    "needles": lambda: needles(),
}


@pytest.fixture(scope="session", params=SCENES)
def scene_mesh(request: pytest.FixtureRequest) -> wrt.TriangleMesh:
    """Built-in scenes, a soup on a coarse grid (equal events, planar triangles, ties), one full of degenerate ones, needles."""
    return SCENES[request.param]()


def snapped_soup(count: int, seed: int) -> wrt.TriangleMesh:
    """Random triangles whose corners lie on a grid of 9 x 9 x 9 points."""
    corners = np.random.default_rng(seed).integers(0, 9, (count, 3, 3)) / 8
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count).reshape(-1, 3))


def degenerate_soup() -> wrt.TriangleMesh:
    """Duplicates of each triangle, needles, points, and triangles in axis-aligned planes."""
    rng = np.random.default_rng(11)
    corners = rng.random((100, 3, 3))
    needles = corners.copy()
    needles[:, 2] = needles[:, 1]
    points = np.repeat(rng.random((50, 1, 3)), 3, axis=1)
    flat = rng.random((90, 3, 3))
    for axis in range(3):
        flat[axis * 30 : (axis + 1) * 30, :, axis] = rng.integers(0, 4, (30, 1)) / 3
    corners = np.concatenate([corners, corners, corners[::-1], needles, points, flat]).astype(np.float32)
    return wrt.TriangleMesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3))


def needles(count: int = 480, seed: int = 17) -> wrt.TriangleMesh:
    """Long triangles 1e3 to 1e8 times as long as wide, across each other, and some ordinary ones among them."""
    rng = np.random.default_rng(seed)
    start, along = rng.random((count, 3)), rng.normal(size=(count, 3))
    along *= rng.uniform(0.3, 0.9, (count, 1)) / np.linalg.norm(along, axis=1, keepdims=True)
    across = np.cross(along, rng.normal(size=(count, 3)))
    across *= np.linalg.norm(along, axis=1, keepdims=True) / np.linalg.norm(across, axis=1, keepdims=True)
    across /= rng.choice([1e3, 1e4, 1e5, 1e6, 1e7, 1e8], (count, 1))
    corners = np.stack([start, start + along, start + rng.random((count, 1)) * along + across], axis=1)
    corners = np.concatenate([corners, rng.random((count // 8, 1, 3)) + rng.uniform(-0.2, 0.2, (count // 8, 3, 3))])
    return wrt.TriangleMesh(corners.reshape(-1, 3).astype(np.float32), np.arange(3 * len(corners)).reshape(-1, 3))


def mixed_rays(mesh: wrt.TriangleMesh, count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Rays of every kind, float32: inside and outside, at vertices and edges, axis-parallel, in planes of faces, bad ones."""
    rng = np.random.default_rng(seed)
    low, high = mesh.bounds
    size = high - low + 1e-6
    origins = rng.uniform(low - 0.3 * size, high + 0.3 * size, (count, 3))
    targets = rng.uniform(low, high, (count, 3))
    corners = mesh.vertices[mesh.faces[rng.integers(0, mesh.triangle_count, count)]]
    kind = rng.integers(0, 8, count)
    targets[kind == 1] = corners[kind == 1, 0]
    targets[kind == 2] = (corners[kind == 2, 0] + corners[kind == 2, 1]) / 2
    targets[kind == 3] = corners[kind == 3].mean(axis=1)
    directions = targets - origins
    axes = np.eye(3)[rng.integers(0, 3, count)] * rng.choice([-1.0, 1.0], (count, 1))
    directions[kind == 4] = axes[kind == 4] * size.max()
    origins[kind == 5] = corners[kind == 5, 0] - 0.7 * (axes * size)[kind == 5]
    directions[kind == 5] = (axes * size)[kind == 5]
    origins[kind == 6] = corners[kind == 6, 1]
    directions[kind == 7] = (corners[:, 1] - corners[:, 0])[kind == 7]
    origins[kind == 7] = (corners[:, 0] - 0.4 * (corners[:, 1] - corners[:, 0]))[kind == 7]
    origins, directions = origins.astype(np.float32), directions.astype(np.float32)
    bad = rng.integers(0, 40, count)
    for code, value in enumerate((np.nan, np.inf, -np.inf)):
        origins[bad == code, code] = value
        directions[bad == code + 3, code] = value
    directions[bad == 6] = 0.0
    return origins, directions


_BRUTE_FORCE: dict[tuple, wrt.Hits] = {}


def brute_force(scene: wrt.Scene, rays: wrt.Rays, **options: str) -> wrt.Hits:
    """Closest hits by brute force, worked out once for the same triangles, rays and options, whatever the scene's tree."""
    arrays = [mesh.vertices for mesh in scene.meshes] + [mesh.faces for mesh in scene.meshes]
    arrays += [rays.origins, rays.directions, rays.t_min, rays.t_max]
    key = (*(hash(np.asarray(a).tobytes()) for a in arrays), str(scene.device), *options.items())
    if key not in _BRUTE_FORCE:
        _BRUTE_FORCE[key] = scene.intersect(rays, traversal="brute", **options)
    return _BRUTE_FORCE[key]


def assert_same_hits(hits: wrt.Hits, expected: wrt.Hits) -> None:
    """Equal to the bit."""
    np.testing.assert_array_equal(hits.primitive_id, expected.primitive_id)
    np.testing.assert_array_equal(hits.geometry_id, expected.geometry_id)
    np.testing.assert_array_equal(hits.t.view(np.int32), expected.t.view(np.int32))
    np.testing.assert_array_equal(hits.uv.view(np.int32), expected.uv.view(np.int32))
