"""Valid files that readers get wrong, each with what is in it: `FILES`. `hostile_gltf` has those of glTF."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from support.hostile_shapes import ANGLE, ARROW, COMB, CUBE, MIXED, QUADS, RING, TRIANGLES, Shape


@dataclass(frozen=True)
class HostileFile:
    """A file and what is right.

    Attributes:
        name: with its extension.
        write: writes it to a path.
        triangles: their number.
        volume: of what they enclose.
        area: together; None if it is not looked at.
        bounds: (2, 3); None if they are not looked at.
        warns: what a warning says; None for none.
    """

    name: str
    write: Callable[[Path], object]
    triangles: int
    volume: float
    area: float | None = None
    bounds: Sequence[Sequence[float]] | None = None
    warns: str | None = None


FILES: list[HostileFile] = []


def add(
    name: str, content: bytes | str, shape: Shape = CUBE, *, copies: int = 1, warns: str | None = None, bounds=None
) -> None:
    """Adds a file that holds so many copies of a shape."""
    data = content.encode() if isinstance(content, str) else content
    count = copies * shape.triangle_count
    FILES.append(
        HostileFile(name, lambda path: path.write_bytes(data), count, copies * shape.volume, copies * shape.area, bounds, warns)
    )


# -- PLY ---------------------------------------------------------------------------------------------------------------

POSITION = "property float x\nproperty float y\nproperty float z\n"
FACE = "property list uchar int vertex_indices\n"


def ply(
    shape: Shape,
    order: str = "",
    *,
    real: str = "f",
    length: str = "B",
    index: str = "i",
    vertex: str = POSITION,
    face: str = FACE,
    before: tuple[float, ...] = (),
    face_before: bytes = b"",
    head: str = "",
    middle: tuple[str, bytes] = ("", b""),
) -> bytes:
    """A PLY file; `order` is "<", ">" or, for text, empty.

    `before` are numbers in front of each position, `face_before` bytes in front of each face, `middle` an element between
    vertices and faces.
    """
    name = {"": "ascii", "<": "binary_little_endian", ">": "binary_big_endian"}[order]
    text = f"ply\nformat {name} 1.0\n{head}element vertex {len(shape.points)}\n{vertex}{middle[0]}"
    text += f"element face {len(shape.polygons)}\n{face}end_header\n"
    if not order:
        rows = [" ".join(map(repr, [*before, *map(float, point)])) for point in shape.points]
        rows += [" ".join(map(str, [len(one), *one])) for one in shape.polygons]
        return (text + "\n".join(rows) + "\n").encode()
    body = b"".join(struct.pack(f"{order}{len(before) + 3}{real}", *before, *point) for point in shape.points)
    body += middle[1]
    for one in shape.polygons:
        body += face_before + struct.pack(order + length, len(one)) + struct.pack(f"{order}{len(one)}{index}", *one)
    return text.encode() + body


DOUBLE = POSITION.replace("float", "double")
add("mixed_text.ply", ply(MIXED), MIXED)
add("mixed_little.ply", ply(MIXED, "<"), MIXED)
add("mixed_big.ply", ply(MIXED, ">"), MIXED)
add("double_uint.ply", ply(CUBE, ">", real="d", index="I", vertex=DOUBLE, face="property list uchar uint vertex_index\n"))
add("bytes_as_indices.ply", ply(MIXED, "<", index="B", face="property list uchar uchar vertex_indices\n"), MIXED)
add("shorts.ply", ply(MIXED, ">", length="H", index="h", face="property list ushort short vertex_indices\n"), MIXED)
add("int_lengths.ply", ply(CUBE, "<", length="i", face="property list int int vertex_indices\n"))
add("quality_first.ply", ply(CUBE, "<", vertex="property float quality\n" + POSITION, before=(9.0,)))
add("normals_text.ply", ply(CUBE, vertex="property float nx\nproperty float ny\n" + POSITION, before=(0.5, -0.5)))
add("concave_text.ply", ply(ANGLE), ANGLE)
add("concave_little.ply", ply(ANGLE, "<"), ANGLE)
add("arrow.ply", ply(ARROW, ">"), ARROW)
add("remarks.ply", ply(CUBE, head="comment element face 99\nobj_info property list float\ncomment\n"))
add("crlf_text.ply", ply(CUBE).replace(b"\n", b"\r\n"))
lists = ("element camera 2\nproperty list uchar float pose\nproperty int id\n", struct.pack("<B2fiBi", 2, 1.0, 2.0, 7, 0, 8))
add("element_of_lists.ply", ply(CUBE, "<", middle=lists))
add(
    "edges_between.ply",
    ply(MIXED, ">", middle=("element edge 1\nproperty int a\nproperty int b\n", struct.pack(">2i", 0, 1))),
    MIXED,
)
flags = "property uchar flags\nproperty list uchar float texcoord\n" + FACE
add("face_with_lists.ply", ply(MIXED, "<", face=flags, face_before=struct.pack("<BB2f", 5, 2, 0.5, 0.5)), MIXED)
reversed_order = f"ply\nformat ascii 1.0\nelement face 6\n{FACE}element vertex 8\n{POSITION}end_header\n"
reversed_order += "".join("4 " + " ".join(map(str, quad)) + "\n" for quad in QUADS)
reversed_order += "".join("{} {} {}\n".format(*point) for point in CUBE.points)
add("faces_first.ply", reversed_order)
strips = f"ply\nformat binary_big_endian 1.0\nelement vertex 8\n{POSITION}element tristrips 1\n"
strips += "property list int int vertex_indices\nend_header\n"
runs = [i for a, b, c, d in QUADS for i in (a, b, d, c, -1)]
strip_body = b"".join(struct.pack(">3f", *point) for point in CUBE.points) + struct.pack(f">i{len(runs)}i", len(runs), *runs)
add("tristrips.ply", strips.encode() + strip_body)
add("word_in_remarks.ply", ply(CUBE, "<", head="comment end_header is below\nobj_info end_header\n"))
add("remark_in_utf_8.ply", ply(CUBE, head="comment by Åse \u2028 \u0085\n"))
line_feed_first = ply(CUBE, "<", vertex="property uchar level\n" + POSITION)
head, body = line_feed_first.split(b"end_header\n")
rows = b"".join(b"\n" + body[12 * k : 12 * (k + 1)] for k in range(8)) + body[96:]
add("cr_before_a_line_feed.ply", head.replace(b"\n", b"\r") + b"end_header\r" + rows)
add("crlf_before_a_line_feed.ply", head.replace(b"\n", b"\r\n") + b"end_header\r\n" + rows)
add("trailing.ply", ply(CUBE, "<") + b"signature", warns="9 bytes behind the last")

# -- OBJ ---------------------------------------------------------------------------------------------------------------


def obj(shape: Shape, corner: str = "{}", vertex: str = "v {} {} {}", shift: float = 0.0, first: int = 1) -> str:
    """An OBJ file; `corner` is what an index becomes."""
    text = "".join(vertex.format(x + shift, y, z) + "\n" for x, y, z in shape.points)
    for one in shape.polygons:
        text += "f " + " ".join(corner.replace("{}", str(i + first)) for i in one) + "\n"
    return text


PLAIN = obj(CUBE)
add("blocks.obj", "".join(obj(CUBE, shift=s, first=-8) for s in (0, 3, 6)), copies=3, bounds=[[0, 0, 0], [7, 1, 1]])
add("tabs.obj", PLAIN.replace(" ", "\t"))
add("comments.obj", PLAIN.replace("\n", " # a side \\ of it\n"))
add("glued_comments.obj", PLAIN.replace("\n", "#side\n"))
add("continued.obj", PLAIN.replace("f ", "f \\\n").replace(" 3", " \\\r\n 3"))
add("colours_behind.obj", obj(CUBE, vertex="v {} {} {} 0.5 0.25 1"))
add("weights_behind.obj", obj(CUBE, vertex="v {} {} {} 1.0"))
add("normals.obj", "vn 0 0 1\n" + obj(CUBE, "{}//1"))
add("coordinates.obj", "vt 0 0\nvt 1 1\nvn 0 0 1\n" + obj(MIXED, "{}/-1/-1", first=-8), MIXED)
add("crlf.obj", PLAIN.replace("\n", "\r\n"))
add("cr.obj", PLAIN.replace("\n", "\r"))
add("byte_order_mark.obj", b"\xef\xbb\xbf" + PLAIN.encode())
add("utf_16.obj", PLAIN.encode("utf-16"))
add("indented.obj", PLAIN.replace("\n", "  \n   "))
add("groups.obj", "o one\ng a b\ns 1\nusemtl red#1\n" + PLAIN + "o two\n" + obj(CUBE, shift=3, first=9), copies=2)
add("faces_first.obj", "".join(sorted(PLAIN.splitlines(keepends=True))))
add("exponents.obj", obj(CUBE, vertex="v {}e0 +{} {}E+00"))
add("old_faces.obj", PLAIN.replace("f ", "fo "))
add("lines_and_points.obj", PLAIN + "l 1 2 3\np 1\nvp 0.5\n")
add("concave.obj", obj(ANGLE), ANGLE)
add("arrow.obj", obj(ARROW), ARROW)
add("comb.obj", obj(COMB), COMB)
add("ring.obj", obj(RING), RING)
add("no_end.obj", PLAIN.rstrip("\n"))

# -- STL ---------------------------------------------------------------------------------------------------------------


def stl(shape: Shape, head: bytes = b"", attribute: int = 0) -> bytes:
    """A binary STL file of a shape of triangles."""
    body = b"".join(struct.pack("<12fH", 0, 0, 0, *shape.points[list(t)].ravel(), attribute) for t in shape.polygons)
    return head.ljust(80, b"\0") + struct.pack("<I", len(shape.polygons)) + body


def stl_text(shape: Shape, name: str = "") -> str:
    """A text STL file of a shape of triangles."""
    text = f"solid {name}\n"
    for t in shape.polygons:
        text += "  facet normal 0 0 0\n    outer loop\n"
        text += "".join("      vertex {} {} {}\n".format(*shape.points[i]) for i in t)
        text += "    endloop\n  endfacet\n"
    return text + f"endsolid {name}\n"


SIDES = Shape(CUBE.points, tuple(map(tuple, TRIANGLES.tolist())), 1.0, 6.0)
add("begins_with_solid.stl", stl(SIDES, b"solid facet made by a program"), SIDES)
add("attributes.stl", stl(SIDES, attribute=0x7C1F), SIDES)
add("trailing.stl", stl(SIDES, b"solid") + bytes(31), SIDES, warns="31 bytes behind the last")
add("facet_in_the_header.stl", stl(SIDES, b"solid facet normal") + b"end", SIDES, warns="3 bytes behind the last")
add("named_as_facets.stl", stl_text(SIDES, "facet normal 1 1 1") + stl_text(SIDES, "outer facet vertex"), SIDES, copies=2)
on_a_line = stl_text(SIDES) + stl_text(SIDES, "a b").replace("b\n", "b ", 1)
add("name_and_facet_on_a_line.stl", on_a_line, SIDES, copies=2)
add("utf_16.stl", stl_text(SIDES).encode("utf-16"), SIDES)
add("upper_case.stl", stl_text(SIDES, "CUBE").upper(), SIDES)
add("one_line.stl", " ".join(stl_text(SIDES).split()), SIDES)
add("several_solids.stl", stl_text(SIDES, "a") + "\n\n" + stl_text(SIDES, "b"), SIDES, copies=2)
add("names_of_words.stl", stl_text(SIDES, "vertex endloop 3"), SIDES)
add("tabs.stl", stl_text(SIDES).replace(" ", "\t").replace("\n", "\r\n"), SIDES)
add("normals_nan.stl", stl_text(SIDES).replace("0 0 0", "nan -nan(ind) 1.#INF", 12), SIDES)

# -- OFF ---------------------------------------------------------------------------------------------------------------


def off(shape: Shape, first: str = "OFF\n", behind: str = "", face_behind: str = "") -> str:
    """An OFF file; `behind` is what each vertex has behind its position."""
    text = f"{first}{len(shape.points)} {len(shape.polygons)} 0\n"
    text += "".join("{} {} {}".format(*point) + behind + "\n" for point in shape.points)
    return text + "".join(f"{len(one)} {' '.join(map(str, one))}{face_behind}\n" for one in shape.polygons)


add("mixed.off", off(MIXED), MIXED)
add("counts_behind_the_word.off", off(CUBE, "OFF "))
add("colours.off", off(CUBE, "COFF\n", " 0.5 0.25 1.0 1.0"))
add("colours_of_bytes.off", off(MIXED, "COFF\n", " 255 0 10"), MIXED)
add("normals.off", off(CUBE, "NOFF\n", " 0 0 1"))
add("all_of_it.off", off(CUBE, "STCNOFF\n", " 0 0 1 0.5 0.5 0.5 1 0.25 0.75"))
add("normals_and_colours_of_meshlab.off", off(CUBE, "NCSTOFF\n", " 255 0 10 255 0 0 1 0.25 0.75"))
add("remarks.off", off(ANGLE, "# made\nOFF # of\n\n").replace("\n", " # by hand\n\n\n"), ANGLE)
add("concave.off", off(ANGLE, face_behind=" 255 0 0"), ANGLE)
add("crlf.off", off(COMB).replace("\n", "\r\n"), COMB)
