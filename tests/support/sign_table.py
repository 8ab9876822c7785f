"""The table of docs/guides/distances.md: which signs are right on hostile meshes.

python -m support.sign_table      # in tests/
"""

from __future__ import annotations

import numpy as np

import wrt
from support.open_surfaces import surfaces

SIGNS = ("parity", "pseudonormal", "winding", "auto")

POINTS = 1000


def wrong_shares() -> dict[str, tuple[str, dict[str, float]]]:
    """For each surface, what is wrong with it, and the percentage of points with a wrong sign by each rule.

    Points at random around the surface, but those within 0.03 of it, where its faces are not yet the body.
    """
    found = {}
    points = np.random.default_rng(0).uniform(-1.6, 1.6, (POINTS, 3))
    for name, (kind, mesh, inside) in surfaces().items():
        scene = wrt.Scene(mesh, device="cpu")
        far = scene.closest_point(points).distance > 0.03
        expected = np.where(inside(points), -1, 1)
        signs = {rule: np.sign(wrt.analysis.signed_distance(scene, points, sign=rule)) for rule in SIGNS}
        found[name] = kind, {rule: float((got != expected)[far].mean() * 100) for rule, got in signs.items()}
    return found


def table() -> str:
    """The rows of the table in Markdown."""
    rows = [
        f"| {name} | {kind} | " + " | ".join(f"{shares[rule]:.1f}" for rule in SIGNS) + " |"
        for name, (kind, shares) in wrong_shares().items()
    ]
    return "\n".join(rows)


if __name__ == "__main__":
    print(table())
