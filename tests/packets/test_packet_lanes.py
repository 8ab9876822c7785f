"""Packets in and out and W rays x a triangle, against one ray at a time in plain Warp, bit for bit."""

from __future__ import annotations

import re

import numpy as np
import pytest
import warp as wp
from support.packet_loops import (
    ANY,
    CLOSEST,
    CLOSEST_BLOCKS,
    LOAD,
    STORE,
    STORE_ANY,
    Packets,
    PlainRays,
    bits,
    loops,
    make_packets,
    plain_rays,
)

from wrt.kernels.layout.ray_batch import HitBatch
from wrt.kernels.traversal.packet.rays.packet_layout import PacketLayout
from wrt.kernels.triangle import TRIANGLE_TESTS

pytestmark = pytest.mark.width

LAYOUTS = [
    PacketLayout(64, 16, True, "woop"),
    PacketLayout(32, 8, False, "woop"),
    PacketLayout(12, 4, False, "moeller_trumbore"),  # whose tiles, 8 x 1, are smaller than packets
    PacketLayout(16, 16, True, "komatsu"),
]


@pytest.fixture(params=LAYOUTS, ids=lambda x: f"{x.triangle_test}-{x.rays}x{x.width}")
def layout(request) -> PacketLayout:
    return request.param


@pytest.fixture(params=[0, 19], ids=["rays", "picture"])
def packets(request, layout, device) -> Packets:
    """Loaded packets: of rays as they come, and of the tiles of a picture, 19 pixels wide."""
    made = make_packets(layout, 6400 // layout.rays, device, request.param)
    made.run(loops(layout), LOAD)
    return made


def scalar_state(layout: PacketLayout, plain: PlainRays) -> dict[str, np.ndarray]:
    """What `prepare` makes of each ray, by the names of the packet's components."""
    test = TRIANGLE_TESTS[layout.triangle_test]
    if test.name == "woop":
        return {"shear_z": plain.state["shear"][..., 2]}
    values = {}
    for value in test.lanes.ray:
        if value.packet:  # such as ray.direction.c[0]
            name, place = re.fullmatch(r"ray\.(\w+)(?:\.c\[(\d)\])?", value.scalar).groups()
            values[f"ray_{value.name}"] = plain.state[name] if place is None else plain.state[name][..., int(place)]
    return values


def test_loaded(packets):
    """Every component of every good ray has the bits of the ray that is loaded alone; all others are not active."""
    plain, got, layout = plain_rays(packets), packets.components(), packets.layout
    valid = plain.valid
    assert 0.5 < valid.mean() < 0.95
    assert not valid[0].any()
    expected = scalar_state(layout, plain)
    direction = plain.ray["direction"]
    with np.errstate(all="ignore"):
        main = np.abs(direction).argmax(axis=-1)  # the first of equals
        slopes = np.stack([np.take_along_axis(direction, (main[..., None] + j) % 3, -1)[..., 0] for j in range(3)])
        expected |= {"slope_x": slopes[1] / slopes[0], "slope_y": slopes[2] / slopes[0]}
    for axis, name in enumerate("xyz"):
        expected[f"inverse_{name}"] = plain.slabs["inverse"][..., axis]
        if not layout.shared_origin:
            expected[f"origin_{name}"] = plain.ray["origin"][..., axis]
    expected |= {} if layout.shared_origin else {"slack": plain.slack}
    expected |= {"t_min": plain.ray["t_min"], "t": plain.ray["t_max"], "u": np.zeros(valid.shape), "v": np.zeros(valid.shape)}
    for name, values in expected.items():
        np.testing.assert_array_equal(bits(got[name])[valid], bits(values.astype(np.float32))[valid], err_msg=name)
    np.testing.assert_array_equal(got["main_axis"][valid], main[valid])
    assert (got["primitive"] == -1).all()
    assert (got["t"][~valid] == -np.inf).all()
    assert set(layout.components) - set(expected) <= {"primitive", "main_axis", "part", "kept"}


def best_candidates(packets: Packets, plain: PlainRays) -> dict[str, np.ndarray]:
    """The closest hits on the first blocks, by looking at all candidates: the least t, then the least id."""
    size = packets.count * packets.layout.rays
    masks = packets.loop.masks.numpy()[:, None, :CLOSEST_BLOCKS, None] >> np.arange(packets.layout.width) & 1
    ids = packets.ids[packets.loop.blocks.numpy()[:, None, :CLOSEST_BLOCKS]]
    t, u, v = np.moveaxis(plain.candidates[:, :, :CLOSEST_BLOCKS], -1, 0)
    t_max = np.where(plain.valid, plain.ray["t_max"], -np.inf)
    counts = (masks != 0) & (t >= plain.ray["t_min"][..., None, None]) & (t <= t_max[..., None, None])
    t, u, v, ids = (np.broadcast_to(x, counts.shape).reshape(size, -1) for x in (t, u, v, ids))
    keys = np.where(counts.reshape(size, -1), t, np.inf)
    best = np.lexsort((ids, keys, ~counts.reshape(size, -1)), axis=-1)[:, :1]
    hit = counts.any(axis=(2, 3)).ravel()
    found = {name: np.take_along_axis(x, best, 1)[:, 0] for name, x in (("t", t), ("u", u), ("v", v), ("primitive", ids))}
    otherwise = {"t": t_max.ravel(), "u": np.float32(0.0), "v": np.float32(0.0), "primitive": -1}
    return {name: np.where(hit, found[name], otherwise[name]).reshape(plain.valid.shape) for name in found}


def test_closest_hits(packets):
    """Three blocks, one after the other: t, triangle and weights of every ray are those of the best candidate."""
    plain = plain_rays(packets)
    packets.run(loops(packets.layout), CLOSEST)
    got, expected = packets.components(), best_candidates(packets, plain)
    for name in ("primitive", "t", "u", "v"):
        np.testing.assert_array_equal(bits(got[name]), bits(expected[name].astype(got[name].dtype)), err_msg=name)
    assert 0.05 < (got["primitive"] >= 0).mean() < 0.9
    np.testing.assert_array_equal(packets.bounds()["t_max"], expected["t"].max(axis=1))


def test_any_hits(packets):
    """A ray is done if the block has a candidate within its range, and then found one of those; no other ray is touched.

    A packet is done with its last ray, and until then keeps its t_max.
    """
    plain, before, t_max = plain_rays(packets), packets.components(), packets.bounds()["t_max"].copy()
    packets.run(loops(packets.layout), ANY)
    got = packets.components()
    blocks, masks = (x.numpy()[:, CLOSEST_BLOCKS] for x in (packets.loop.blocks, packets.loop.masks))
    t = plain.candidates[:, :, CLOSEST_BLOCKS, :, 0]
    asked = (masks[:, None, None] >> np.arange(packets.layout.width) & 1) != 0
    counts = asked & (t >= plain.ray["t_min"][..., None]) & (t <= plain.ray["t_max"][..., None]) & plain.valid[..., None]
    hit = counts.any(axis=-1)
    assert 0.02 < hit.mean() < 0.9
    np.testing.assert_array_equal(got["primitive"] >= 0, hit)
    of_these = (got["primitive"][..., None] == packets.ids[blocks][:, None]) & counts
    np.testing.assert_array_equal(of_these.any(axis=-1), hit)
    np.testing.assert_array_equal(bits(got["t"]), bits(np.where(hit, np.float32(-np.inf), before["t"])))
    done = (got["t"] < 0.0).all(axis=1)
    assert 0.0 < done.mean() < 1.0
    np.testing.assert_array_equal(packets.bounds()["t_max"], np.where(done, np.float32(-np.inf), t_max))


def test_stored(packets):
    """Hits go to the numbers of their rays, in a picture too, and nothing is written beyond the last."""
    loop, plain, device = packets.loop, plain_rays(packets), packets.device
    packets.run(loops(packets.layout), CLOSEST)
    total, room = loop.rays.count, packets.count * packets.layout.rays
    hits = HitBatch()
    hits.t, hits.primitive = wp.full(room, 7.0, dtype=float, device=device), wp.full(room, 7, dtype=int, device=device)
    hits.uv = wp.full(room, wp.vec2(7.0, 7.0), dtype=wp.vec2, device=device)
    hits.occluded = wp.zeros(room, dtype=wp.bool, device=device)
    loop.hits = hits
    packets.run(loops(packets.layout), STORE)
    packets.run(loops(packets.layout), STORE_ANY)
    got, there = packets.components(), plain.number >= 0
    number, hit = plain.number[there], got["primitive"] >= 0
    assert 0.05 < hit.mean() < 0.9
    t = hits.t.numpy()
    np.testing.assert_array_equal(bits(t[number]), bits(np.where(hit, got["t"], np.float32(np.inf))[there]))
    np.testing.assert_array_equal(hits.primitive.numpy()[number], got["primitive"][there])
    np.testing.assert_array_equal(hits.uv.numpy()[number], np.stack([got["u"], got["v"]], axis=-1)[there])
    np.testing.assert_array_equal(hits.occluded.numpy()[number], hit[there])
    assert (t[total:] == 7.0).all()
    assert (hits.primitive.numpy()[total:] == 7).all()
    assert (hits.uv.numpy()[total:] == 7.0).all()
    assert not hits.occluded.numpy()[total:].any()
