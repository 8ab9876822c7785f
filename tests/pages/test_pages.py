"""The site's pages: their Python runs as it stands, their links lead somewhere, and nothing public is left out.

The blocks of a page run one after the other, in a folder of their own that has a mesh `model.ply`. A block after the comment
<!-- needs: NAME --> runs where NAME is to be had: a package, or "cuda".
"""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import warp as wp

import wrt

DOCS = Path(__file__).resolve().parents[2] / "docs"
NOT_RUN = {"adding.md": "tests/pages/test_adding.py follows it"}
GATHERED = ("notebooks", "records", "_build")
"""Folders that a build of the site makes in docs/."""

PAGES = {
    path.relative_to(DOCS).as_posix(): path.read_text(encoding="utf-8")
    for path in sorted(DOCS.rglob("*.md"))
    if path.relative_to(DOCS).parts[0] not in GATHERED
}

BLOCK = re.compile(r"(?:<!-- needs: (\w+) -->\n)?^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)

RUN = [page for page, text in PAGES.items() if BLOCK.search(text) and page not in NOT_RUN]


def is_here(need: str) -> bool:
    """Whether what a block needs is to be had: a CUDA device, or a package that can be imported."""
    if need == "cuda":
        return bool(wp.get_cuda_devices())
    try:
        import_module(need)
    except ImportError:
        return False
    return True


def run_page(page: str, folder: Path) -> tuple[dict, list[str]]:
    """What the page's blocks leave behind, and what those needed that could not run."""
    names, missing = {"__name__": "page"}, []
    for number, (need, code) in enumerate(BLOCK.findall(PAGES[page])):
        if need and not is_here(need):
            missing.append(need)
            continue
        path = folder / f"block_{number}.py"  # Warp reads the source of kernels
        path.write_text(code, encoding="utf-8")
        exec(compile(code, str(path), "exec"), names)
    return names, missing


def check_start(names):
    assert len(BLOCK.findall(PAGES["start.md"])[0][1].splitlines()) <= 12
    assert names["hits"].is_hit.mean() > 0.3
    assert names["lit"].shape == names["hits"].shape
    assert Path("model.png").stat().st_size > 10_000


def check_queries(names):
    np.testing.assert_array_equal(names["number"], names["lists"].count)
    assert names["three"].count.max() <= 3 < names["number"].max()
    assert 0.01 < names["inside"].mean() < 0.9
    assert names["volume"] > 0.0
    assert names["around"].shape == (16, 100_000)
    assert names["matrix"].shape == (len(names["points"]),) * 2
    assert names["matrix"].diagonal().all()
    np.testing.assert_array_equal(names["again"].t, names["hits"].t)
    assert {"nodes", "leaves", "triangles"} <= names["work"].keys()


def check_drop_in(names):
    hits = wrt.Scene(wrt.TriangleMesh.load("model.ply")).intersect(names["rays"][:, :3], names["rays"][:, 3:])
    np.testing.assert_array_equal(names["answer"]["t_hit"], hits.t)
    assert set(names["index_ray"]) == set(np.flatnonzero(names["number"]))
    assert (names["hidden"] == np.isfinite(names["answer"]["t_hit"])).all()
    assert len(names["lists"]["ray_ids"]) == names["number"].sum()
    np.testing.assert_allclose(names["apart"], names["distance"], rtol=1e-4, atol=1e-6)
    assert np.isclose(names["depth"], -names["signed"], rtol=1e-4, atol=1e-6).mean() > 0.99  # the model has gaps
    np.testing.assert_array_equal(names["occupied"], names["inside"])
    np.testing.assert_allclose(names["deep"], names["depth"], rtol=1e-4, atol=1e-5)


def check_point_clouds(names):
    """The scan is that of the mesh, to half a spacing for most beams; intensities are of points."""
    scan, spacing = names["scan"], names["spacing"]
    mesh = names["lidar"].scan(names["scene"], names["pose"])
    both = np.isfinite(scan.range) & np.isfinite(mesh.range)
    assert both.mean() > 0.5
    assert (np.abs(scan.range - mesh.range)[both] < 1.5 * spacing).mean() > 0.95
    assert len(np.unique(scan.intensity)) > 100
    assert 0.1 < (names["shade"] > 0).mean() < 0.9
    assert names["cloud"].last_update is not None


def check_lidar(names):
    assert names["ranges"].shape == names["facing"].shape == (64, 720)
    assert names["sweep"].is_hit.mean() > 0.5
    assert np.nanmax(names["ranges"][names["sweep"].is_hit]) <= 40.0
    assert 1 <= names["strongest"] <= 3
    again = names["scene"].intersect(names["path"][3], names["rings"], t_max=40.0).t
    np.testing.assert_array_equal(names["depth"][3], again.ravel())


def check_sensors(names):
    scan, moving = names["scan"], names["moving"]
    assert scan.range.shape == (64, 1024)
    assert np.isfinite(scan.range).mean() > 0.5
    assert {0, 1} <= set(np.unique(scan.instance_id))
    assert np.isfinite(names["second"]).sum() > 100
    assert 0.01 < np.isinf(names["noisy"].range[np.isfinite(scan.range)]).mean() < 0.03
    assert moving.motion_error == pytest.approx(5.0 * 0.1 / 16 / 2, rel=0.01)
    far = moving.instance_id == 0
    world = names["straight"][far] + [-2.0, 0.5, 1.8]
    np.testing.assert_allclose(world, moving.position[far], atol=1e-9)
    assert np.nanmax(np.abs(names["approach"])) < np.hypot(10.0, 5.0)
    assert len(names["table"]) == np.isfinite(moving.range).sum()
    images = names["images"]
    assert {1, 5} <= set(np.unique(images.semantic_id))
    assert (images.depth <= images.distance)[images.instance_id >= 0].all()
    np.testing.assert_allclose(names["direction"] * 2.0 / names["direction"][2], [0.2, -0.1, 2.0], atol=1e-9)
    assert names["sheared"].depth.shape == (480, 640)
    half = np.sqrt(0.5)
    turn = names["rotations_of"](*np.array([[1.0, 0, 0, 0], [half, 0, 0, half]]).T)  # by nothing, and by 90 degrees about z
    np.testing.assert_allclose(turn, [np.eye(3), [[0, -1, 0], [1, 0, 0], [0, 0, 1]]], atol=1e-15)
    np.testing.assert_array_equal(names["matrices"](np.ones((2, 3)), turn)[:, :3, :3], turn)
    np.testing.assert_array_equal(names["matrices"](np.ones((2, 3)), turn)[:, :, 3], 1.0)


def check_sun_hours(names):
    """At noon on midsummer the sun is at 90 - 48 + 23.45 degrees, in the south; the open court gets more than its arcades.
    What faces away from the sun is not lit."""
    noon = names["sun_directions"](48.0, 172, 12.0)
    np.testing.assert_allclose(noon, [0.0, -np.cos(np.radians(65.45)), np.sin(np.radians(65.45))], atol=1e-3)
    morning, evening = names["sun_directions"](48.0, 172, [9.0, 15.0])
    np.testing.assert_allclose(morning * [-1, 1, 1], evening)
    assert morning[0] > 0.0
    hours = names["sun_hours"]
    assert 0.0 <= np.nanmin(hours) < np.nanmax(hours) <= 16.1
    assert 0.05 < names["openness"].mean() <= 1.0
    assert 0.05 < names["sky_view"].mean() <= 1.1  # of 128 directions
    assert (names["full_hours"] <= 16.1).all()
    np.testing.assert_array_equal(names["lit"], names["lit_above"])  # windings of the court are right
    facing = (names["towards"] * names["facade"].normal).sum(axis=-1) > 0.0
    assert names["facade"].is_hit.all()
    assert 0.01 < names["wall_lit"].mean() < facing.mean()
    assert not names["wall_lit"][~facing].any()
    np.testing.assert_array_equal(names["matrix"], names["matrix"].T)


def check_shadows(names):
    """The point light and the area light leave some points in light and some in shadow, and see the same points."""
    assert 0.05 < names["dark"].mean() < 0.95
    assert names["fraction"].shape == names["dark"].shape
    assert names["fraction"].min() == 0.0
    assert names["fraction"].max() == 1.0
    assert 0.0 < ((names["fraction"] > 0.0) & (names["fraction"] < 1.0)).mean() < 0.5
    np.testing.assert_array_equal(names["fraction"][:100], np.float32(1.0) - names["hidden"].mean(axis=1, dtype=np.float32))


def check_mesh_files(names):
    assert names["mesh"].triangle_count == 4
    assert names["mesh"].surface_area == 3.0


def check_moving(names):
    assert set(names["met"].instance_id) >= {-1, 0, 1, 100}
    assert names["shade"].mean() <= names["forest"].occluded(names["origins"], names["directions"]).mean() < 1
    meshes = {2: names["stage"].meshes, 3: names["groups"].meshes, 5: (names["film"].meshes[0],)}
    for frame, scene in ((2, names["stage"]), (3, names["groups"]), (5, names["film"])):
        np.testing.assert_array_equal(meshes[frame][-1].vertices, names["walk"].frames[frame])
        found = scene.intersect(names["origins"][:2000], names["directions"][:2000])
        expected = wrt.Scene(meshes[frame]).intersect(names["origins"][:2000], names["directions"][:2000])
        np.testing.assert_array_equal(found.t, expected.t)


def check_large_scenes(names):
    assert names["scene"].part_count > 10
    assert names["again"].memory < names["again"].bytes / 2
    assert (names["dark"] <= (names["crossings"] > 0)).all()


def check_large_batches(names):
    expected = names["scene"].intersect([0, 0, 2], names["lidar"])
    np.testing.assert_array_equal(names["t"], expected.t)
    np.testing.assert_array_equal(names["dark"], expected.t <= 1.0)
    assert len(list(Path("trees").iterdir())) == 1
    np.testing.assert_array_equal(names["again"].intersect([0, 0, 2], names["lidar"]).t, expected.t)


def check_clusters(names):
    shaded = names["scene"].occluded(names["points"][:, None], names["suns"]).sum(axis=1)
    for name in ("shaded", "same", "on_dask", "on_gpus"):
        np.testing.assert_array_equal(names.get(name, shaded), shaded)
    assert names["open_share"] == 1.0 - names["scene"].occluded(*names["around"](0, 100_000)).mean()


def check_own_kernels(names):
    seen = names["scene"].intersect(names["camera"].rays()).is_hit
    assert (names["picture"][~seen] == 0).all()
    assert 0.3 < names["picture"][seen].mean() < 0.95
    row = names["scene"].intersect(names["eye"].numpy(), names["fan"].numpy()).t
    np.testing.assert_array_equal(names["depth"].numpy(), row)


def check_gradients(names):
    found = names["guess"].numpy()[0]
    np.testing.assert_allclose(found, names["camera"].position, atol=1e-3 * names["mesh"].extent)


def check_exact(names):
    both = names["hits"].is_hit & names["exact"].is_hit
    assert both.mean() > 0.3
    np.testing.assert_allclose(names["exact"].t[both], names["hits"].t[both], rtol=1e-3, atol=1e-5)


def check_known_rays(names):
    np.testing.assert_array_equal(names["shaded"], names["scene"].occluded(names["shadow"]))


def check_auto(names):
    assert (names["plan"].traversal, names["hits"].plan.traversal) == ("stream", "stream")
    assert names["same"].plan.culling == "interval"


def check_rendering(names):
    pictures = [names[key] for key in ("image", "lamplit", "preview", "toned", "blurred", "moving")]
    assert all(picture.shape == (120, 160, 3) and 0.02 < picture.mean() < 0.98 for picture in pictures)
    assert 0.0 < names["last"] < names["first"]
    np.testing.assert_allclose(names["adaptive"].counts.mean(), 16.0, rtol=0.1)
    assert np.ptp(names["adaptive"].counts) > 0
    assert 0.02 < names["inside"].mean() < 0.98
    lengths = np.array([[0.3], [0.1], [np.inf]])  # both panes, one, and the beam
    np.testing.assert_allclose(names["share"], np.exp(-lengths * [0.5, 1.0, 2.0]), rtol=1e-5)
    if "smooth" in names:
        assert names["smooth"].shape == names["color"].shape
        assert np.abs(np.diff(names["smooth"], axis=1)).mean() < np.abs(np.diff(names["color"], axis=1)).mean()
    assert (names["depth"] < np.inf).mean() > 0.3
    hit = names["hits"].is_hit
    np.testing.assert_allclose(names["heights"][hit], names["hits"].position[hit][:, 2], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(names["normals"][hit], axis=1), 1.0, atol=1e-5)


def check_live_view(names):
    if "viewer" in names:  # viser is at hand
        assert names["viewer"].url.startswith("http://127.0.0.1:")


def check_cameras(names: dict) -> None:
    assert names["hits"].is_hit.any()
    assert (names["images"].instance_id >= 0).any()
    assert 36.0 < names["camera"].fov < 39.0  # 50 degrees are along the longer side


def check_tutorial(names: dict) -> None:
    assert 0.1 < names["hits"].is_hit.mean() < 0.9
    assert names["share"].shape == (names["hits"].is_hit.sum(),)
    assert 0.0 <= names["share"].min() < names["share"].max() <= 1.0
    assert 0.0 < np.nanmin(names["thickness"]) < np.nanmax(names["thickness"]) < np.inf


def check_distances(names: dict) -> None:
    assert names["rule"] == "winding"
    within = np.abs(names["distance"]) <= 0.05
    np.testing.assert_array_equal(names["band"], np.where(within, names["distance"], np.copysign(np.inf, names["distance"])))
    assert 0.01 < within.mean() < 0.9
    assert 0.05 < (names["number"] > 0.5).mean() < 0.9
    assert names["wall"].shape == names["diameter"].shape == names["openness"].shape == names["surface"].shape
    assert 0.0 < names["openness"].min() + 0.1 < names["openness"].max() <= 1.0
    assert 0.1 < names["seen"].mean() < 0.6
    assert 0.05 < names["view"].mean() < 0.95
    assert np.abs(names["thin"].values).max() == np.float32(0.1)
    assert names["x"].shape == names["grid"].values.shape[:1]
    assert np.median(names["scene"].closest_point(names["again"].vertices).distance) < 0.1 * names["grid"].spacing


def check_facades(names):
    """Blocks are closed and have their volumes; the gable is flat and whole; the highest roof has the sun of a free plane."""
    for block, feature in zip(names["blocks"], names["features"], strict=True):
        solid = block.to_trimesh().process(merge_tex=True)
        solid.merge_vertices()
        assert solid.is_watertight
        np.testing.assert_allclose(solid.volume, 234.0 * feature["properties"]["height"], rtol=1e-3)
    gable = names["gable"]
    np.testing.assert_allclose(gable.vertices[:, 1], 0.0, atol=1e-6)
    area = np.linalg.norm(
        np.cross(*(gable.vertices[gable.faces[:, k]] - gable.vertices[gable.faces[:, 0]] for k in (1, 2))), axis=1
    )
    np.testing.assert_allclose(0.5 * area.sum(), 45.0)
    apart = names["facade"].position
    nearest = np.sort(np.linalg.norm(apart[:200, None] - apart, axis=-1), axis=1)[:, 1]
    assert nearest.min() >= 1.999
    if "on_map" not in names:
        return
    free = (names["direct"] @ names["sun"][:, 2] + names["diffuse"]) / 1000.0
    top = names["ground"].position[..., 2] > names["high"][2] - 0.01
    assert top.any()
    np.testing.assert_allclose(names["on_map"][top], np.broadcast_to(free, (top.sum(), 12)), rtol=1e-3)
    assert names["on_map"].max() <= free.max() * 1.001
    facing = names["facade"].normal[:, 2] < -0.9  # the undersides of blocks
    np.testing.assert_array_equal(names["on_facades"][facing], 0.0)
    south, north = (names["on_facades"][(names["facade"].normal[:, 1] * sign) > 0.9].sum(axis=-1).mean() for sign in (-1, 1))
    assert south > 2.0 * north
    assert names["hidden"].shape == (len(apart),)
    if "file" in names and "rasterio" in names:
        with names["rasterio"].open("sun.tif") as stored:
            assert stored.count == 12
            np.testing.assert_allclose(np.moveaxis(stored.read(), 0, -1), names["on_map"], rtol=1e-6)


def check_reading(names):
    from wrt.builders.kdtree import KDTREE_BUILDERS

    assert KDTREE_BUILDERS.pop("golden").build is names["build"]  # other tests do not know it
    for hits in names["found"].values():
        np.testing.assert_array_equal(hits.t, names["found"]["sweep"].t)
        assert hits.counters["triangles"].mean() >= names["found"]["sweep"].counters["triangles"].mean()
    assert (names["found"]["golden"].counters["nodes"] != names["found"]["spatial_median"].counters["nodes"]).any()


def check_pytorch(names):
    assert names["losses"][-1] < 0.1 * names["losses"][0]
    assert names["depth"].isfinite().sum() == names["hits"].is_hit.sum() > 1000
    assert names["vertices"].grad.shape == names["mesh"].vertices.shape


def check_gpu(names):
    """Of rays from where a float32 has the eye, as on the device, the CPU gives the same bits."""
    rays = np.float32(names["camera"].position), names["directions"].numpy()
    np.testing.assert_array_equal(names["found"].t.numpy(), wrt.Scene(names["mesh"], device="cpu").intersect(*rays).t)
    assert (names["found"].is_hit.numpy() == names["hits"].is_hit.ravel()).mean() > 0.999


def check_jax(names):
    assert names["misfits"][-1] < 1e-4 * names["misfits"][0]
    np.testing.assert_allclose(names["guess"], names["camera"].position, atol=1e-3 * names["mesh"].extent)


def check_simulation(names):
    """Crates are where the solver has them, and rays see those that have moved."""
    places = names["body_q"].numpy()
    np.testing.assert_array_equal([one.transform[2, 3] for one in names["scene"].instances], places[:, 2])
    again = wrt.Scene(names["scene"].instances).intersect(names["eye"].numpy(), names["directions"].numpy())
    np.testing.assert_array_equal(names["ranges"].numpy(), again.t)
    assert (names["bodies"].numpy() < 64).mean() > 0.05


CHECKS = {
    "guides/pytorch.md": check_pytorch,
    "guides/jax.md": check_jax,
    "guides/simulation.md": check_simulation,
    "guides/facades.md": check_facades,
    "reading.md": check_reading,
    "start.md": check_start,
    "tutorial.md": check_tutorial,
    "guides/queries.md": check_queries,
    "guides/drop_in.md": check_drop_in,
    "guides/lidar.md": check_lidar,
    "guides/point_clouds.md": check_point_clouds,
    "guides/sensors.md": check_sensors,
    "guides/shadows.md": check_shadows,
    "guides/sun_hours.md": check_sun_hours,
    "guides/mesh_files.md": check_mesh_files,
    "guides/moving.md": check_moving,
    "guides/large_batches.md": check_large_batches,
    "guides/clusters.md": check_clusters,
    "guides/large_scenes.md": check_large_scenes,
    "guides/own_kernels.md": check_own_kernels,
    "guides/gradients.md": check_gradients,
    "guides/exact.md": check_exact,
    "guides/distances.md": check_distances,
    "guides/known_rays.md": check_known_rays,
    "guides/cameras.md": check_cameras,
    "guides/rendering.md": check_rendering,
    "guides/live_view.md": check_live_view,
    "guides/gpu.md": check_gpu,
    "concepts/auto.md": check_auto,
}
"""What is asked of the names that a page's blocks leave behind."""


def test_every_page_with_code_is_checked():
    assert sorted(CHECKS) == RUN
    assert set(NOT_RUN) <= PAGES.keys()


ON_CARDS = ["guides/simulation.md", *(page for page in RUN if "<!-- needs: cuda -->" in PAGES[page])]
"""Pages that run on a CUDA device where there is one."""


@pytest.mark.parametrize("page", [pytest.param(page, marks=[pytest.mark.cuda] * (page in ON_CARDS)) for page in RUN])
def test_code_runs(page, tmp_path, monkeypatch):
    """As a reader would run it. Blocks whose needs are missing are skipped with a message, and the others count."""
    wrt.scenes.build("teapot", level=6, ground=False).save(tmp_path / "model.ply")
    monkeypatch.chdir(tmp_path)
    names, missing = run_page(page, tmp_path)
    if len(missing) == len(BLOCK.findall(PAGES[page])):
        pytest.skip(f"all blocks of docs/{page} need {', '.join(sorted(set(missing)))}")
    CHECKS[page](names)
    if missing:
        pytest.skip(f"all of docs/{page} ran and was right but the blocks that need {', '.join(missing)}")


DRAWN = {"drawn/rooms.svg": "draw_rooms", "drawn/query.svg": "draw_query", "drawn/frames.svg": "draw_frames"}
"""Pictures that are drawn when the site is built, and what draws them."""


@pytest.mark.parametrize("picture", DRAWN)
def test_pictures_are_drawn(picture, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(DOCS)
    pytest.importorskip("matplotlib", reason="matplotlib is not installed: pip install 'wrt[test-all]'")
    import drawings

    path = tmp_path / Path(picture).name
    getattr(drawings, DRAWN[picture])(path)
    assert path.read_text().count("<path") > 10
    assert any(picture in text for text in PAGES.values())


@pytest.mark.parametrize("page", PAGES)
def test_links_lead_somewhere(page):
    for link in re.findall(r"\]\((?!https?:)([^)#]+)", PAGES[page]):
        assert link in DRAWN or (DOCS / page).parent.joinpath(link).exists(), link


@pytest.mark.parametrize("page", PAGES)
def test_pages_speak_of_nothing_temporary(page):
    """No place on one machine, and no line too long to read."""
    assert not re.search(r"/(work|opt|tmp|home)/", PAGES[page])
    assert all(len(line) <= 140 or line.startswith(("|", "```")) for line in PAGES[page].splitlines())


def test_every_page_is_in_a_contents_list():
    listed = {"index.md"}
    for page, text in PAGES.items():
        for block in re.findall(r"```\{toctree\}\n(.*?)```", text, re.DOTALL):
            entries = [line for line in block.splitlines() if line and not line.startswith(":")]
            listed |= {(Path(page).parent / f"{entry}.md").as_posix() for entry in entries}
    assert PAGES.keys() <= listed


MODULES = tuple(name for name in (*wrt.__all__, *wrt._BESIDE) if isinstance(getattr(wrt, name), ModuleType))
"""Public modules, whose own names are public."""


@pytest.mark.parametrize("name", [name for name in wrt.__all__ if name not in ("__version__", *MODULES)])
def test_every_public_name_is_in_the_reference(name):
    reference = "\n".join(text for page, text in PAGES.items() if page.startswith("api/"))
    assert re.search(rf"^\.\. auto(class|function):: wrt\.{name}$", reference, re.MULTILINE)


@pytest.mark.parametrize("module", MODULES)
def test_public_modules_are_in_the_reference(module):
    text = "\n".join(text for page, text in PAGES.items() if page.startswith("api/"))
    assert f".. automodule:: wrt.{module}" in text
    if module == "device":  # its docstring explains what kernels call
        assert all(f":: wrt.device.{name}\n" in text for name in ("launch", "differentiable_hits", "show_compiling"))
    else:
        for name in getattr(wrt, module).__all__:
            assert name == "BUILTIN_SCENES" or f":: wrt.{module}.{name}\n" in text, f"wrt.{module}.{name}"


def test_cited_records_exist():
    """Those that code, tests and pages name, and those that records link to."""
    root, cited = DOCS.parent, set()
    for folder in ("kernels", "builders", "wrt", "tests", "docs", "notebooks/records"):
        for path in (*(root / folder).rglob("*.py"), *(root / folder).rglob("*.md")):
            text = path.read_text(encoding="utf-8")
            cited |= set(re.findall(r"notebooks/records/([\w.-]+\.md)", text))
            if path.parent.name == "records":
                cited |= set(re.findall(r"\]\(([\w.-]+\.md)\)", text))
    assert len(cited) > 50
    assert sorted(name for name in cited if not (root / "notebooks" / "records" / name).exists()) == []
