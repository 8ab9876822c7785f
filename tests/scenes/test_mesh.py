"""TriangleMesh: what it refuses, what it keeps, what it reads and what it says about a mesh."""

import pickle
import sys

import numpy as np
import pytest
import trimesh

import wrt
from wrt.meshes.mesh import TriangleMesh
from wrt.meshes.mesh_arrays import checked_faces

SQUARE = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]])
TWO = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)


def with_vertex(index, value):
    vertices = SQUARE.copy()
    vertices[index] = value
    return vertices


# -- refusals ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("vertices", "faces", "error", "message"),
    [
        (SQUARE[:, :2], TWO, ValueError, r"vertices must have shape \(V, 3\), got \(4, 2\)"),
        (SQUARE.ravel(), TWO, ValueError, r"vertices must have shape"),
        ([[0.0, 0.0, 0.0], [1.0, 0.0]], TWO, ValueError, r"vertices must be an array of shape"),
        (SQUARE, TWO.ravel(), ValueError, r"faces must have shape \(F, 3\), got \(6,\)"),
        (SQUARE, [[0, 1]], ValueError, r"faces must have shape"),
        (SQUARE, [[0, 1, 2, 3]], ValueError, r"quads; triangulate"),
        (SQUARE, np.empty((0, 3), dtype=np.int32), ValueError, r"faces is empty"),
        (SQUARE, [], ValueError, r"faces is empty"),
        (np.empty((0, 3)), TWO, ValueError, r"there are 0 vertices"),
        (SQUARE, [[0, 1, 2], [0, 2, 4], [9, 0, 1]], ValueError, r"faces\[1\] refers to vertex 4, but there are 4"),
        (SQUARE, [[0, 1, 4]], ValueError, r"faces\[0\] refers to vertex 4, but there are 4"),  # the first that is none
        (SQUARE, [[0, 1, 2], [0, -1, 2]], ValueError, r"faces\[1\] refers to vertex -1"),
        (SQUARE, np.array([[0, 1, 2**40]]), ValueError, r"faces\[0\] refers to vertex 1099511627776"),
        (SQUARE, np.array([[0, 1, 2**32 + 2]], dtype=np.uint64), ValueError, r"refers to vertex 4294967298"),
        (SQUARE, TWO.astype(float), TypeError, r"faces must be integer.*float64"),
        (SQUARE, TWO.astype(bool), TypeError, r"faces must be integer.*bool"),
        (SQUARE, TWO.astype(object), TypeError, r"faces must be integer.*object"),
        (SQUARE.astype(complex), TWO, TypeError, r"vertices must be real.*complex"),
        (SQUARE.astype(bool), TWO, TypeError, r"vertices must be real.*bool"),
        (SQUARE.astype(object), TWO, TypeError, r"vertices must be real.*object"),
        (SQUARE.astype(str), TWO, TypeError, r"vertices must be real"),
        (with_vertex((2, 1), np.nan), TWO, ValueError, r"1 of 4 are NaN or infinite, the first is vertex 2"),
        (with_vertex(slice(1, 4), np.inf), TWO, ValueError, r"3 of 4 are NaN or infinite, the first is vertex 1"),
        (with_vertex((3, 0), -np.inf), TWO[:1], ValueError, r"vertex 3"),  # no triangle uses it: refused all the same
    ],
)
def test_bad_arrays(vertices, faces, error, message):
    with pytest.raises(error, match=message):
        TriangleMesh(vertices, faces)


def test_missing_file(tmp_path):
    with pytest.raises(FileNotFoundError, match=r"nothing\.ply"):
        TriangleMesh.load(tmp_path / "nothing.ply")


@pytest.mark.parametrize(
    ("file_name", "content"),
    [
        ("mesh.unheard", "1 2 3"),
        ("mesh", "1 2 3"),
        ("mesh.ply", "not a ply file"),
        ("cut.ply", "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\n"),
        ("mesh.stl", "neither binary nor text"),
        ("empty.stl", ""),
        ("empty.obj", ""),
        ("points.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\n"),
        ("points.xyz", "0 0 0\n1 0 0\n0 1 0\n"),
        ("outside.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("nan.obj", "v 0 0 nan\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"),
    ],
)
def test_unreadable_file(tmp_path, file_name, content):
    (tmp_path / file_name).write_text(content)
    with pytest.raises(ValueError, match=file_name.replace(".", r"\.")):
        TriangleMesh.load(tmp_path / file_name)


def test_from_trimesh_refuses_other_things():
    with pytest.raises(TypeError, match=r"TriangleMesh\.load"):
        TriangleMesh.from_trimesh("bunny.ply")
    with pytest.raises(ValueError, match="no triangles"):
        TriangleMesh.from_trimesh(trimesh.Scene())


# -- arrays ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_right_arrays_are_copied_once(dtype):
    """A caller that wrote into its faces made kernels read out of bounds; arrays of another mesh nobody can write to."""
    vertices, faces = SQUARE.astype(dtype), TWO.copy()
    mesh = TriangleMesh(vertices, faces)
    assert not np.shares_memory(mesh.vertices, vertices)
    assert not np.shares_memory(mesh.faces, faces)
    assert mesh.vertices.dtype == dtype
    assert vertices.flags.writeable  # the caller's own array stays as it was
    again = TriangleMesh(mesh.vertices, mesh.faces)
    assert np.shares_memory(again.vertices, mesh.vertices)
    assert np.shares_memory(again.faces, mesh.faces)


def test_indices_are_checked_in_the_copy():
    """Between the check and the copy, another thread could write to the caller's array."""
    faces = TWO.astype(np.int32)

    class Count:
        """Compares as the number of vertices, and writes to the array then."""

        __array_ufunc__ = None

        def __le__(self, largest):
            faces[:] = 1 << 30
            return len(SQUARE) <= largest

    np.testing.assert_array_equal(checked_faces(faces, Count()), TWO)
    assert (faces == 1 << 30).all()


@pytest.mark.parametrize("dtype", [np.int8, np.uint16, np.int64, np.float16, ">f8", np.longdouble])
def test_other_real_types_become_native_float64(dtype):
    mesh = TriangleMesh(SQUARE.astype(dtype), TWO.astype(np.uint64))
    assert mesh.vertices.dtype == np.float64
    assert mesh.vertices.dtype.isnative
    assert mesh.faces.dtype == np.int32
    np.testing.assert_array_equal(mesh.vertices, SQUARE)


def test_strided_arrays_become_contiguous():
    mesh = TriangleMesh(np.repeat(SQUARE, 2, axis=0)[::2], np.asfortranarray(TWO))
    assert mesh.vertices.flags.c_contiguous
    assert mesh.faces.flags.c_contiguous
    np.testing.assert_array_equal(mesh.faces, TWO)


def test_arrays_are_read_only():
    mesh = TriangleMesh(SQUARE.copy(), TWO.copy())
    for array in (mesh.vertices, mesh.faces, mesh.bounds):
        with pytest.raises(ValueError, match="read-only"):
            array[0, 0] = 7
    with pytest.raises(AttributeError):
        mesh.vertices = SQUARE


def test_degenerate_and_duplicate_triangles_are_legal():
    mesh = TriangleMesh([[0, 0, 0], [1, 0, 0], [2, 0, 0], [0, 1, 0]], [[0, 1, 3], [3, 0, 1], [1, 0, 3], [0, 1, 2], [1, 1, 3]])
    summary = mesh.summary()
    assert summary["degenerate_triangles"] == 2
    assert summary["duplicate_triangles"] == 2
    np.testing.assert_array_equal(mesh.face_normals[3:], 0.0)
    np.testing.assert_array_equal(mesh.face_normals[0], [0.0, 0.0, 1.0])


# -- measures ----------------------------------------------------------------------------------------------------------


def test_measures_of_a_box():
    mesh = TriangleMesh.from_trimesh(trimesh.creation.box(extents=(1.0, 2.0, 3.0)), name="box")
    np.testing.assert_allclose(mesh.bounds, [[-0.5, -1.0, -1.5], [0.5, 1.0, 1.5]])
    np.testing.assert_allclose(mesh.center, 0.0)
    assert mesh.extent == pytest.approx(np.sqrt(14.0))
    assert mesh.surface_area == pytest.approx(22.0)
    centroids = mesh.vertices[mesh.faces].mean(axis=1)
    assert ((mesh.face_normals * centroids).sum(axis=1) > 0.0).all()
    assert np.abs(mesh.face_normals).max(axis=1) == pytest.approx(1.0)
    summary = mesh.summary()
    assert summary == {
        "name": "box",
        "triangles": 12,
        "vertices": 8,
        "bounds": [[-0.5, -1.0, -1.5], [0.5, 1.0, 1.5]],
        "surface_area": pytest.approx(22.0),
        "degenerate_triangles": 0,
        "duplicate_triangles": 0,
        "is_closed": True,
    }
    assert "box" in repr(mesh)
    assert "12 triangles" in repr(mesh)


def test_closed_means_every_edge_has_two_faces():
    sphere = TriangleMesh.from_trimesh(trimesh.creation.icosphere(subdivisions=2))
    assert sphere.summary()["is_closed"]
    assert not TriangleMesh(sphere.vertices, sphere.faces[1:]).summary()["is_closed"]  # a hole
    twice = TriangleMesh(sphere.vertices, np.concatenate([sphere.faces, sphere.faces[:5, ::-1]]))
    assert twice.summary()["duplicate_triangles"] == 5
    assert not twice.summary()["is_closed"]  # edges with three and four faces
    soup = TriangleMesh(sphere.vertices[sphere.faces].reshape(-1, 3), np.arange(3 * sphere.triangle_count).reshape(-1, 3))
    assert soup.summary()["is_closed"]  # positions count, not indices
    collapsed = TriangleMesh(sphere.vertices, np.concatenate([sphere.faces, [[0, 0, 1], [2, 2, 2]]]))
    assert collapsed.summary()["is_closed"]
    assert collapsed.summary()["degenerate_triangles"] == 2


def test_welding_counts_minus_zero_as_zero():
    flat = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-0.0, 0.0, -0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]
    mesh = TriangleMesh([*flat, [9.0, 9.0, 9.0]], [[0, 1, 2], [4, 3, 5]]).welded()
    assert mesh.vertex_count == 4
    np.testing.assert_array_equal(mesh.vertices[mesh.faces][1], np.array(flat)[[4, 3, 5]])


def test_bounds_ignore_unused_vertices():
    np.testing.assert_array_equal(TriangleMesh(with_vertex(3, 100.0), TWO[:1]).bounds, [[0, 0, 0], [1, 1, 0]])


@pytest.mark.parametrize("scale", [1e-200, 1e-30, 1.0, 1e30, 1e150])
def test_normals_at_any_scale(scale):
    mesh = TriangleMesh(SQUARE * scale, TWO)
    np.testing.assert_allclose(mesh.face_normals, [[0, 0, 1], [0, 0, 1]])


# -- files and scenes --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "off", "glb"])
def test_save_and_load_keep_the_order(tmp_path, suffix):
    random = np.random.default_rng(5)
    vertices = random.integers(-50, 50, (40, 3)).astype(np.float32) / 4.0  # exact in text and in float32
    faces = np.array([random.choice(40, 3, replace=False) for _ in range(60)], dtype=np.int32)
    mesh = TriangleMesh(vertices, faces)
    path = tmp_path / f"mesh.{suffix}"
    mesh.save(path)
    loaded = TriangleMesh.load(str(path))
    assert loaded.name == "mesh"
    np.testing.assert_allclose(loaded.vertices[loaded.faces], vertices[faces], atol=1e-6)
    if suffix in ("ply", "obj", "off"):
        np.testing.assert_array_equal(loaded.faces, faces)


def ply_file(order="little", real="float", index="int", more="", corners=3):
    """A binary PLY file of `SQUARE` and `TWO`."""
    sign, types = {"little": "<", "big": ">"}[order], {"float": "f4", "double": "f8", "int": "i4", "uint": "u4"}
    header = f"ply\nformat binary_{order}_endian 1.0\ncomment made here\nelement vertex {len(SQUARE)}\n"
    header += "".join(f"property {real} {axis}\n" for axis in "xyz")
    header += f"element face {len(TWO)}\nproperty list uchar {index} vertex_indices\n{more}end_header\n"
    rows = np.zeros(len(TWO), dtype=[("corners", "u1"), ("vertex", sign + types[index], 3)])
    rows["corners"], rows["vertex"] = corners, TWO
    return header.encode() + (np.asarray(SQUARE) + 0.1).astype(sign + types[real]).tobytes() + rows.tobytes()


@pytest.mark.parametrize("order", ["little", "big"])
@pytest.mark.parametrize(("real", "index"), [("float", "int"), ("double", "uint")])
def test_plain_ply_files_are_read_as_by_trimesh(tmp_path, monkeypatch, order, real, index):
    """Importing trimesh took a fifth of the time of a picture; such files are read without it."""
    path = tmp_path / "mesh.ply"
    path.write_bytes(ply_file(order, real, index))
    expected = TriangleMesh.from_trimesh(trimesh.load(path, process=False))
    monkeypatch.setitem(sys.modules, "trimesh", None)
    mesh = TriangleMesh.load(path)
    for name in ("vertices", "faces"):
        found, wanted = getattr(mesh, name), getattr(expected, name)
        assert found.dtype == wanted.dtype
        np.testing.assert_array_equal(found, wanted)
    assert (mesh.name, mesh.up, mesh.materials) == ("mesh", (0.0, 1.0, 0.0), expected.materials)


def loaded_with(tmp_path, content):
    path = tmp_path / "mesh.ply"
    path.write_bytes(content)
    return TriangleMesh.load(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (ply_file()[:-1], "ends before the last of 2 rows of the element 'face'"),
        (ply_file().replace(b"element vertex 4", b"element vertex 9999999999"), "rows of the element 'vertex'"),
        (ply_file().replace(b"element face 2", b"element face 0"), "no triangles"),
        (b"ply\nformat ascii 1.0\n", "no line 'end_header'"),
    ],
    ids=["cut", "vertices", "faces", "header"],
)
def test_ply_files_that_are_cut_off_are_refused(tmp_path, content, message):
    with pytest.raises(ValueError, match=message):
        loaded_with(tmp_path, content)


def test_ply_files_with_more_in_them(tmp_path):
    """Bytes behind the last row are named; other properties are skipped."""
    with pytest.warns(UserWarning, match=r"mesh\.ply': 4 bytes behind the last"):
        np.testing.assert_array_equal(loaded_with(tmp_path, ply_file() + b"more").faces, TWO)
    rows = np.zeros(len(TWO), dtype=[("corners", "u1"), ("vertex", "<i4", 3), ("weight", "<f4")])
    rows["corners"], rows["vertex"] = 3, TWO
    plain = ply_file(more="property float weight\n")
    content = plain[: -len(TWO) * 13] + rows.tobytes()
    np.testing.assert_array_equal(loaded_with(tmp_path, content).faces, TWO)


@pytest.mark.parametrize("suffix", ["ply", "obj", "stl", "off", "glb"])
def test_the_format_says_which_axis_points_up(tmp_path, suffix):
    TriangleMesh(SQUARE, TWO).save(tmp_path / f"mesh.{suffix}")
    assert TriangleMesh.load(tmp_path / f"mesh.{suffix}").up == (None if suffix == "stl" else (0.0, 1.0, 0.0))


def test_the_upward_direction_follows_the_mesh():
    """From arrays none is known. Copies keep it, maps move it, and meshes that differ in it have none together."""
    assert TriangleMesh(SQUARE, TWO).up is None
    mesh = TriangleMesh(SQUARE, TWO, up=(0, 3, 0))
    assert mesh.up == mesh.welded().up == pickle.loads(pickle.dumps(mesh)).up == (0.0, 1.0, 0.0)
    to_z_up = trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0])
    np.testing.assert_allclose(mesh.transformed(to_z_up).up, (0, 0, 1), atol=1e-15)
    assert mesh.transformed(np.diag([2.0, 0.0, 2.0, 1.0])).up is None
    plain = TriangleMesh(SQUARE, TWO)
    assert plain.transformed(to_z_up).up is None
    assert TriangleMesh.concatenate([mesh, plain]).up == mesh.up
    turns = [trimesh.transformations.rotation_matrix(angle, [0, 1, 0]) for angle in (0.1, 2.0)]
    np.testing.assert_allclose(wrt.Scene([wrt.Instance(mesh, turn) for turn in turns]).flattened().up, (0, 1, 0), atol=1e-15)
    assert TriangleMesh.concatenate([mesh, TriangleMesh(SQUARE, TWO, up=(1, 0, 0))]).up is None


@pytest.mark.parametrize("up", [(0, 0, 0), (0, 1), (0, np.nan, 1)])
def test_bad_upward_directions_are_refused(up):
    with pytest.raises(ValueError, match="up must be three"):
        TriangleMesh(SQUARE, TWO, up=up)
    with pytest.raises(TypeError, match="up must hold real numbers"):
        TriangleMesh(SQUARE, TWO, up="y")


def test_save_refuses_unknown_formats(tmp_path):
    with pytest.raises(ValueError, match="unheard"):
        TriangleMesh(SQUARE, TWO).save(tmp_path / "mesh.unheard")


def test_obj_groups_and_materials_do_not_reorder(tmp_path):
    # Readers that group by material return the red triangles first, or the groups backwards.
    path = tmp_path / "groups.obj"
    path.write_text(
        "mtllib none.mtl\no thing\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0\nvt 1 1\nvn 0 0 1\n"
        "usemtl red\nf 1/1/1 2/2/1 3/1/1\nusemtl blue\ng part\nf 1//1 2//1 4//1\nusemtl red\nf 2/1 3/2 4/2\nf 1 3 4\n"
    )
    mesh = TriangleMesh.load(path)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [0, 1, 3], [1, 2, 3], [0, 2, 3]])
    assert mesh.vertex_count == 4


def test_scenes_are_flattened_into_world_coordinates(tmp_path):
    scene = trimesh.Scene()
    box = trimesh.creation.box()
    scene.add_geometry(box, geom_name="box", transform=trimesh.transformations.translation_matrix([10.0, 0.0, 0.0]))
    scene.add_geometry(box, geom_name="far", transform=trimesh.transformations.translation_matrix([0.0, 20.0, 0.0]))
    scene.add_geometry(trimesh.PointCloud(np.full((4, 3), 99.0)))
    scene.graph.update("again", geometry="box", matrix=trimesh.transformations.scale_matrix(2.0))
    mesh = TriangleMesh.from_trimesh(scene)
    assert mesh.triangle_count == 36
    np.testing.assert_allclose(mesh.bounds, [[-1.0, -1.0, -1.0], [10.5, 20.5, 1.0]])
    np.testing.assert_allclose(mesh.vertices[mesh.faces[:12]], box.vertices[box.faces] + [10.0, 0.0, 0.0])
    scene.export(tmp_path / "scene.glb")
    np.testing.assert_allclose(TriangleMesh.load(tmp_path / "scene.glb").bounds, mesh.bounds, atol=1e-6)


def test_to_trimesh_round_trip():
    mesh = TriangleMesh(SQUARE, TWO)
    copy = mesh.to_trimesh()
    copy.vertices[0] = 5.0  # a copy: the mesh is not touched
    again = TriangleMesh.from_trimesh(mesh.to_trimesh())
    np.testing.assert_array_equal(again.vertices, SQUARE)
    np.testing.assert_array_equal(again.faces, TWO)


# -- new meshes --------------------------------------------------------------------------------------------------------


def test_transformed():
    box = TriangleMesh(trimesh.creation.box().vertices.astype(np.float32), trimesh.creation.box().faces)
    matrix = trimesh.transformations.rotation_matrix(0.3, [1.0, 2.0, 3.0], [4.0, 5.0, 6.0])
    moved = box.transformed(matrix)
    assert moved.vertices.dtype == np.float32
    np.testing.assert_allclose(moved.vertices, trimesh.transform_points(box.vertices, matrix), atol=1e-5)
    np.testing.assert_array_equal(moved.faces, box.faces)


def test_mirroring_keeps_normals_outward():
    mirrored = TriangleMesh.from_trimesh(trimesh.creation.icosphere()).transformed(np.diag([-1.0, 2.0, 1.0, 1.0]))
    centroids = mirrored.vertices[mirrored.faces].mean(axis=1)
    assert ((mirrored.face_normals * centroids).sum(axis=1) > 0.0).all()


@pytest.mark.parametrize("matrix", [np.eye(3), np.full((4, 4), np.nan), np.eye(4) + np.eye(4)[[3, 0, 1, 2]]])
def test_transformed_refuses_what_is_not_affine(matrix):
    with pytest.raises(ValueError, match="matrix must be"):
        TriangleMesh(SQUARE, TWO).transformed(matrix)


def test_concatenate():
    single = TriangleMesh(SQUARE.astype(np.float32), TWO)
    double = TriangleMesh(SQUARE + 5.0, TWO[:1])
    joined = TriangleMesh.concatenate([single, double, single], name="three")
    assert joined.name == "three"
    assert joined.vertices.dtype == np.float64
    assert TriangleMesh.concatenate([single, single]).vertices.dtype == np.float32
    np.testing.assert_array_equal(joined.faces, [*TWO, [4, 5, 6], *(TWO + 8)])
    with pytest.raises(ValueError, match="meshes is empty"):
        TriangleMesh.concatenate([])


def test_referenced_vertices():
    """Those of triangles; an update, which keeps the triangles, finds the same without looking."""
    mesh = TriangleMesh(with_vertex(3, 100.0), TWO[:1])
    np.testing.assert_array_equal(mesh.referenced, [True, True, True, False])
    assert not mesh.referenced.flags.writeable
    scene = wrt.Scene(mesh, device="cpu")
    scene.update(0, vertices=mesh.vertices + 1.0)
    assert scene.meshes[0].referenced is mesh.referenced
