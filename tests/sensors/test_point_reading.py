"""Readers of points: what the writers wrote and what other libraries write, and files that are damaged."""

from __future__ import annotations

import struct

import numpy as np
import pytest

from wrt.sensors import PointCloud, read_points, write_points
from wrt.sensors.files.pcd_file import decompress

TYPE = [("x", "<f8"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<u2"), ("label", "<i4")]


@pytest.fixture(scope="module")
def table():
    rng = np.random.default_rng(4)
    made = np.zeros(50, dtype=TYPE)
    for name in made.dtype.names:
        made[name] = rng.uniform(0, 1000, 50)
    made["label"] -= 500
    made["x"] += 691_000.0625
    return made


def same(read: np.ndarray, expected: np.ndarray) -> None:
    assert read.dtype.names == expected.dtype.names
    for name in read.dtype.names:
        assert read.dtype[name] == expected.dtype[name]
        np.testing.assert_array_equal(read[name], expected[name])


@pytest.mark.parametrize("suffix", [".ply", ".pcd"])
def test_what_was_written(table, tmp_path, suffix):
    write_points(tmp_path / f"map{suffix}", table)
    same(read_points(tmp_path / f"map{suffix}"), table)


def test_kitti(table, tmp_path):
    own = table[["x", "y", "z", "intensity"]].astype([(name, "<f4") for name in ("x", "y", "z", "intensity")])
    write_points(tmp_path / "0.bin", own)
    same(read_points(tmp_path / "0.bin"), own)
    (tmp_path / "0.bin").write_bytes(b"123")
    with pytest.raises(ValueError, match="no whole number of rows"):
        read_points(tmp_path / "0.bin")


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_las(table, tmp_path, suffix):
    pytest.importorskip("laspy", reason='laspy is not installed: pip install "wrt[sensors]"')
    write_points(tmp_path / f"map{suffix}", table[["x", "y", "z", "label"]])
    read = read_points(tmp_path / f"map{suffix}")
    for axis in "xyz":
        assert read[axis].dtype == np.float64
        np.testing.assert_allclose(read[axis], table[axis], atol=5.1e-4)
    np.testing.assert_array_equal(read["label"], table["label"])
    assert {"intensity", "classification", "return_number", "gps_time"} <= set(read.dtype.names)
    whole = (tmp_path / f"map{suffix}").read_bytes()
    for end in (0, 50, 300, len(whole) - 200):
        (tmp_path / f"cut{suffix}").write_bytes(whole[:end])
        with pytest.raises(ValueError, match="cannot be read"):
            read_points(tmp_path / f"cut{suffix}")
    with pytest.raises(FileNotFoundError):
        read_points(tmp_path / f"none{suffix}")


@pytest.mark.parametrize("suffix", [".las", ".laz"])
def test_a_missing_library_is_named(tmp_path, monkeypatch, suffix):
    monkeypatch.setitem(__import__("sys").modules, "laspy", None)
    with pytest.raises(ImportError, match=r'need laspy: pip install "wrt\[sensors\]"'):
        read_points(tmp_path / f"map{suffix}")


def packed(data: bytes) -> bytes:
    """LZF of literal runs, and of copies where eight bytes come again at once."""
    made, at = bytearray(), 0
    while at < len(data):
        if at >= 8 and data[at : at + 8] == data[at - 8 : at]:
            length = 8
            while length < 200 and data[at + length : at + length + 1] == data[at + length - 8 : at + length - 7] != b"":
                length += 1
            made += bytes([7 << 5, length - 9, 7]) if length >= 9 else bytes([(length - 2) << 5, 7])
            at += length
        else:
            made += bytes([0, data[at]])
            at += 1
    return bytes(made)


HEADER = """# .PCD v0.7 - Point Cloud Data file format
VERSION 0.7
FIELDS x y z _ rgb _ n
SIZE 4 4 8 1 4 2 2
TYPE F F F U U U I
COUNT 1 1 1 3 1 1 2
WIDTH {count}
HEIGHT 1
POINTS {count}
DATA {form}
"""
ROW = np.dtype(
    [("x", "<f4"), ("y", "<f4"), ("z", "<f8"), ("a", "u1", 3), ("rgb", "<u4"), ("b", "<u2"), ("n", "<i2", 2)]
)  # as in HEADER


def pcd(form: str, count: int = 40, **other: int) -> bytes:
    """A file with paddings, repeated numbers and a field of two."""
    rows = np.zeros(count, dtype=ROW)
    rows["x"], rows["y"], rows["z"] = np.arange(count) / 8, np.nan, 1 / 3
    rows["rgb"], rows["n"] = 0xFF00FF, np.arange(2 * count).reshape(count, 2) - 7
    head = HEADER.format(form=form, count=other.get("says", count)).encode()
    if form == "binary":
        return head + rows.tobytes()
    if form == "ascii":
        lines = [" ".join(str(one) for name in ROW.names for one in np.ravel(row[name])) for row in rows]
        return head + "\r\n".join(lines).encode()
    columns = b"".join(rows[name].tobytes() for name in ROW.names)
    short = packed(columns)
    return head + struct.pack("<II", other.get("packed", len(short)), other.get("size", len(columns))) + short


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_forms_of_pcd(tmp_path, form):
    path = tmp_path / "map.pcd"
    path.write_bytes(pcd(form))
    read = read_points(path)
    assert read.dtype.names == ("x", "y", "z", "rgb", "n")
    np.testing.assert_array_equal(read["x"], np.arange(40, dtype=np.float32) / 8)
    assert np.isnan(read["y"]).all()
    np.testing.assert_array_equal(read["z"], np.full(40, 1 / 3))
    np.testing.assert_array_equal(read["rgb"], 0xFF00FF)
    np.testing.assert_array_equal(read["n"], np.arange(80).reshape(40, 2) - 7)
    with pytest.raises(ValueError, match="40 points that are not finite"):
        PointCloud(read, 0.1)
    path.write_bytes(pcd(form, 0))
    assert len(read_points(path)) == 0
    whole = pcd(form)
    for end in [*range(0, 300, 7), len(whole) - 100, len(whole) - 1]:
        path.write_bytes(whole[:end])
        if form == "ascii" and end == len(whole) - 1:  # the last number is shorter
            assert len(read_points(path)) == 40
        else:
            with pytest.raises(ValueError, match=r"map\.pcd' cannot be read"):
                read_points(path)


@pytest.mark.parametrize("form", ["ascii", "binary", "binary_compressed"])
def test_pcd_of_pypcd4(table, tmp_path, form):
    """Another library's writer."""
    pypcd4 = pytest.importorskip("pypcd4", reason="pypcd4 is not installed: pip install pypcd4")
    own = np.stack([table[axis].astype(np.float32) for axis in "xyz"], axis=1)
    cloud = pypcd4.PointCloud.from_xyz_points(np.repeat(own, 20, axis=0))
    cloud.save(tmp_path / "map.pcd", encoding=getattr(pypcd4.Encoding, form.upper()))
    read = read_points(tmp_path / "map.pcd")
    for axis, column in zip("xyz", own.T, strict=True):
        np.testing.assert_array_equal(read[axis], np.repeat(column, 20))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (("FIELDS x", "FIELDS w"), "no coordinates x; its fields are w, y, z"),
        (("FIELDS x y", "FIELDS y y"), "the same name"),
        (("SIZE 4", "SIZE 3"), "no type of numbers"),
        (("SIZE 4", "SIZE -4"), "no whole numbers"),
        (("TYPE F", "TYPE Q"), "no type of numbers"),
        (("COUNT 1 1", "COUNT 1 0"), "has no numbers"),
        (("COUNT 1 1", "COUNT 1"), "of different lengths"),
        (("COUNT 1 1", "COUNT 1 99999"), "100008 numbers"),
        (("COUNT 1 1", "COUNT 2 1"), "need 1320 bytes, but 1160 follow"),
        (("WIDTH 40", "WIDTH 41"), "POINTS 40, but WIDTH and HEIGHT of 41"),
        (("WIDTH 40", "WIDTH 1e9"), "no whole numbers"),
        (("WIDTH 40\nHEIGHT 1\nPOINTS 40", "WIDTH 999999999999\nHEIGHT 1"), "need 28999999999971 bytes, but 1160 follow"),
        (("WIDTH 40\n", ""), "no line 'WIDTH'"),
        (("DATA binary", "DATA zip"), "the forms are ascii, binary, binary_compressed"),
        (("DATA binary", "# binary"), "no line 'DATA'"),
    ],
)
def test_headers_that_lie(tmp_path, change, said):
    text = HEADER.format(form="binary", count=40)
    assert change[0] in text
    data = pcd("binary")
    (tmp_path / "map.pcd").write_bytes(text.replace(*change, 1).encode() + data[len(text) :])
    with pytest.raises(ValueError, match=said):
        read_points(tmp_path / "map.pcd")


@pytest.mark.parametrize(
    ("other", "said"),
    [
        ({"says": 39}, "1160 bytes, but its header announces 1131"),
        ({"packed": 1 << 30}, "follow the header"),
        ({"size": 1 << 31}, "2147483648 bytes, but its header announces 1160"),
        ({"packed": 20}, "cut off|make"),
    ],
)
def test_compressed_points_that_lie(tmp_path, other, said):
    (tmp_path / "map.pcd").write_bytes(pcd("binary_compressed", **other))
    with pytest.raises(ValueError, match=said):
        read_points(tmp_path / "map.pcd")


def test_decompression():
    data = b"abcabcabcabcabcabcX" + bytes(300)
    assert decompress(packed(data), len(data)) == data
    assert decompress(b"\x02abc" + bytes([7 << 5, 6, 2]), 18) == b"abcabc" * 3  # a copy of itself, and a long one
    assert decompress(b"", 0) == b""
    for wrong, size in (
        (b"\x20\x00", 3),
        (b"\x02ab", 3),
        (b"\x00a" + bytes([7 << 5]), 9),
        (b"\x00a\x20\x00", 9),
        (b"\x00a", 2),
    ):
        with pytest.raises(ValueError, match="its compressed points"):
            decompress(wrong, size)
    with pytest.raises(ValueError, match="or more, not 10"):
        decompress(b"\x00a" + bytes([7 << 5, 255, 0]) * 1000, 10)


def test_text_that_is_no_number(tmp_path):
    for old, new, said in (
        (b"nan", b"n.n", "'y' holds"),
        (b"16711935", b"4294967296", "'rgb' holds"),
        (b" 0 0 0 ", b" 0 ", "numbers, not"),
    ):
        (tmp_path / "map.pcd").write_bytes(pcd("ascii").replace(old, new, 1))
        with pytest.raises(ValueError, match=said):
            read_points(tmp_path / "map.pcd")


def test_ply_of_others(tmp_path):
    path = tmp_path / "map.ply"
    head = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\n"
    head += "property {} z\nproperty uchar red\nend_header\n"
    path.write_text(head.format("float") + "1 2 3 4\n5 6 nan 255\n")
    read = read_points(path)
    np.testing.assert_array_equal(read["red"], [4, 255])
    np.testing.assert_array_equal(read["z"], [3, np.nan])
    for text, said in (
        (head.format("float") + "1 2 3 4\n", "ends before|fewer|complete"),
        (head.replace(" z", " depth").format("float") + "1 2 3 4\n5 6 7 8\n", "no coordinates z"),
        ("solid\n", "does not begin"),
        ("ply\nformat ascii 1.0\nelement face 0\nproperty list uchar int vertex_indices\nend_header\n", "no element 'vertex'"),
    ):
        path.write_text(text)
        with pytest.raises(ValueError, match=said):
            read_points(path)


def test_unknown_suffix(tmp_path):
    with pytest.raises(ValueError, match=r"\.ply, \.bin, \.pcd, \.las, \.laz"):
        read_points(tmp_path / "map.txt")
