"""Lidars by their public data sheets.

An entry names its sheet, and says which of its figures were compared with a published text (`LidarPreset.checked`) and with
which; the others were written down from memory and may be wrong. Where a sheet is silent, the lidar's default stands: no least
range, no threshold. Intensities are relative, so thresholds follow from a stated range for a stated reflectance.

References: velodyne; ouster; robosense; livox-2019.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.sensors.lidar_pattern import LidarPattern

Attributes = dict[str, Any]
"""Attributes of a `wrt.sensors.Lidar`."""


@dataclass(frozen=True)
class LidarPreset:
    """An entry of `wrt.sensors.LIDARS`.

    Attributes:
        description: what it is, in words.
        source: the data sheet.
        checked: which figures were compared with a published text, and which were not.
        attributes: gives those of the `Lidar`; takes options of its pattern, and attributes that replace the sheet's.
    """

    description: str
    source: str
    checked: str
    attributes: Callable[..., Attributes]


def threshold(reflectance: float, range: float) -> float:
    """The intensity of a surface of some reflectance, met at a right angle, at the greatest range at which it is detected."""
    return reflectance * (10.0 / range) ** 2  # 10 m: the default of `Lidar.reference_range`


def velodyne_vlp16(*, rate: float = 10.0, **options: Any) -> Attributes:
    """16 lasers, -15 to 15 degrees; a firing every 2.304 us, a cycle of 16 every 55.296 us, of which 18.43 us without a firing.

    Confirmed: angles and their order, and the times, by public decoders that cite the manual; 100 m and 3 cm, by a public
    extract of the manual. The manual gives the 3 cm as accuracy; here they are a standard deviation.
    """
    fired = np.array([-15, 1, -13, 3, -11, 5, -9, 7, -7, 9, -5, 11, -3, 13, -1, 15], dtype=np.float64)
    pattern = _velodyne(fired, 2.304e-6, 55.296e-6, rate)
    return {"pattern": pattern, "max_range": 100.0, "range_noise": 0.03} | options


def velodyne_hdl32e(*, rate: float = 10.0, **options: Any) -> Attributes:
    """32 lasers, -30.67 to 10.67 degrees; a firing every 1.152 us, a cycle of 32 every 46.08 us.

    Confirmed by the manual: all angles (to a hundredth of a degree) and the order of firings, 5 cm to 100 m. **Not confirmed**:
    the times of firings, and the noise of 2 cm.
    """
    lower = -30.67 + 4.0 / 3.0 * np.arange(16)
    fired = np.stack([lower, lower + 64.0 / 3.0], axis=1).ravel()
    pattern = _velodyne(fired, 1.152e-6, 46.08e-6, rate)
    return {"pattern": pattern, "min_range": 0.05, "max_range": 100.0, "range_noise": 0.02} | options


def _velodyne(fired: np.ndarray, interval: float, cycle: float, rate: float) -> LidarPattern:
    """Lasers from top to bottom; ring 0 is the lowest."""
    order = np.argsort(-fired)
    times = interval * np.arange(len(fired))[order]
    rings = np.arange(len(fired))[::-1]
    return LidarPattern.spinning(fired[order], round(1.0 / (rate * cycle)), rate=rate, firing_times=times, rings=rings)


OS1 = {
    "min_range": 0.8,
    "max_range": 120.0,
    "range_noise": 0.015,
    "angle_noise": float(np.radians(0.01)),
    "threshold": threshold(0.8, 120.0),
}


def ouster_os1_64(*, rate: float = 10.0, columns: int = 1024, **options: Any) -> Attributes:
    """64 lasers, -16.6 to 16.6 degrees, which fire at the same time; four neighbours stagger in azimuth.

    Confirmed: all elevations and the stagger, by the default angles of the first generation in the maker's SDK (to a
    thousandth of a degree); the other figures, by the sheet. **Not confirmed**: that the stagger's sign is that of azimuths
    here.
    """
    offsets = np.tile([3.164, 1.055, -1.055, -3.164], 16)
    pattern = LidarPattern.spinning(np.linspace(16.611, -16.611, 64), columns, rate=rate, azimuth_offsets=offsets)
    return {"pattern": pattern, "divergence": float(np.radians(0.13)), **OS1} | options


def ouster_os1_128(*, rate: float = 10.0, columns: int = 1024, **options: Any) -> Attributes:
    """128 lasers, -22.5 to 22.5 degrees, which fire at the same time.

    Confirmed by the sheet. **Not confirmed**: that elevations are even, and that there is no stagger: a device's own file of
    beam angles says what they are.
    """
    pattern = LidarPattern.spinning(np.linspace(22.5, -22.5, 128), columns, rate=rate)
    return {"pattern": pattern, "divergence": float(np.radians(0.18)), **OS1} | options


def robosense_m1(*, rate: float = 10.0, **options: Any) -> Attributes:
    """120 x 25 degrees in steps of 0.2 degrees: 125 rows of 600 beams, drawn as one raster (the device draws five side by
    side).

    Confirmed by the user guide: five channels side by side, measured at the same time. **Not confirmed**: all other figures.
    """
    pattern = LidarPattern.raster(125, 600, horizontal=119.8, vertical=24.8, rate=rate)
    sheet = {"min_range": 0.5, "max_range": 200.0, "range_noise": 0.05, "threshold": threshold(0.1, 150.0)}
    return {"pattern": pattern, **sheet} | options


def livox_mid40(*, frame: int = 0, duration: float = 0.1, **options: Any) -> Attributes:
    """A rosette of 38.4 degrees across, 100,000 beams a second. Frame after frame fills the disk: `frame` is the number of
    the scan, of `duration` seconds each.

    **Not confirmed**: all figures; no public text of the manual's table of specifications was in reach, and the speeds of the
    prisms are in none.
    """
    count = round(100_000 * duration)
    pattern = LidarPattern.rosette(count, half_angle=19.2, speeds=(7294.0, -4664.0), point_rate=100_000.0, first=frame * count)
    sheet = {"max_range": 260.0, "range_noise": 0.02, "threshold": threshold(0.8, 260.0)}
    return {"pattern": pattern, **sheet} | options


LIDARS = {
    "velodyne_vlp16": LidarPreset(
        "16 lasers, spinning",
        "Velodyne: VLP-16 user manual 63-9243; range accuracy of 3 cm taken as a standard deviation",
        "elevations, their order and times of firings, in public decoders; greatest range and accuracy, in an extract of the "
        "manual",
        velodyne_vlp16,
    ),
    "velodyne_hdl32e": LidarPreset(
        "32 lasers, spinning",
        "Velodyne: HDL-32E user's manual; range accuracy of 2 cm taken as a standard deviation",
        "elevations, order of firings, least and greatest range, in the manual; not verified: times of firings, noise",
        velodyne_hdl32e,
    ),
    "ouster_os1_64": LidarPreset(
        "64 lasers, spinning",
        "Ouster: OS1 high resolution imaging lidar, data sheet of the first generation (0.8 to 120 m at 80 % reflectance, "
        "0.13 degrees); stagger and exact elevations: default beam angles of that generation in the maker's public driver",
        "ranges, reflectance, field of view, divergence, noise of ranges (at a high signal) and of angles, on the sheet; "
        "elevations and stagger, in the maker's SDK; not verified: the sign of the stagger",
        ouster_os1_64,
    ),
    "ouster_os1_128": LidarPreset(
        "128 lasers, spinning",
        "Ouster: OS1 high resolution imaging lidar, data sheet of the first generation (45 degrees, 0.18 degrees)",
        "ranges, reflectance, field of view, divergence, noise of ranges (at a high signal) and of angles, on the sheet; not "
        "verified: elevations within the field of view, stagger",
        ouster_os1_128,
    ),
    "robosense_m1": LidarPreset(
        "solid state, 125 rows of 600 beams",
        "RoboSense: RS-LiDAR-M1 data sheet (120 x 25 degrees, 0.2 degrees, 10 Hz, 750,000 points a second, 150 m at 10 %)",
        "not verified",
        robosense_m1,
    ),
    "livox_mid40": LidarPreset(
        "non-repetitive rosette, 100,000 beams a second",
        "Livox: Mid-40 data sheet (38.4 degrees, 260 m at 80 %, 2 cm). Two Risley prisms: R. G. Brazeal, B. E. Wilkinson, "
        "H. H. Hochmair: A rigorous observation model for the Risley prism-based Livox Mid-40 lidar sensor. Sensors 21(14), "
        "2021; to first order here, with speeds of 7,294 and -4,664 turns a minute, which the sheet does not give",
        "not verified",
        livox_mid40,
    ),
}
"""Lidars by name."""
