"""Lenses of every model."""

from __future__ import annotations

from wrt.sensors import BrownConrady, DoubleSphere, Equirectangular, FTheta, KannalaBrandt, Orthographic

CENTRE = {"fx": 600.0, "fy": 590.0, "cx": 319.5, "cy": 241.0}

FISHEYE = {"fx": 250.0, "fy": 245.0, "cx": 319.5, "cy": 241.0}

BARREL = (-0.28, 0.09, 1e-3, -7e-4, -0.012)

RATIONAL = (0.4, -0.2, 3e-4, -5e-4, 0.03, 0.72, -0.1, 0.02)

LENSES = {
    "pinhole": BrownConrady(**CENTRE),
    "barrel": BrownConrady(**CENTRE, distortion=BARREL),
    "rational": BrownConrady(**CENTRE, distortion=RATIONAL),
    "prism": BrownConrady(**CENTRE, distortion=(*RATIONAL, 1e-3, -4e-4, -8e-4, 3e-4)),
    "skewed": BrownConrady(**CENTRE, distortion=BARREL, skew=-12.0),
    "kannala_brandt": KannalaBrandt(**FISHEYE, distortion=(0.04, -0.01, 3e-3, -4e-4)),
    "skewed_fisheye": KannalaBrandt(**FISHEYE, distortion=(0.04, -0.01, 3e-3, -4e-4), skew=7.0),
    "f_theta": FTheta(319.5, 241.0, (260.0, 3.0, -8.0, 0.5)),
    "double_sphere": DoubleSphere(**FISHEYE, xi=-0.2, alpha=0.6),
    "double_sphere_narrow": DoubleSphere(**FISHEYE, xi=0.3, alpha=0.3),
    "equirectangular": Equirectangular(640, 482),
    "orthographic": Orthographic(fx=40.0, fy=41.0, cx=319.5, cy=241.0),
}
