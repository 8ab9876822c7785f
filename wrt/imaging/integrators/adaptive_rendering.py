"""Adaptive sampling: the picture grows where it is noisy.

**Problem.** The sky needs few samples a pixel, the shadow of a leaf needs many.

**Method.** All pixels get a pilot of samples. Then each gets further ones in proportion to the standard deviation of its
samples over its luminance, both averaged over its neighbours. That makes the sum of squared relative errors least for a number
of samples.

**Bias.** A pixel whose first samples missed a rare bright one gets fewer afterwards, and stays too dark: means of samples whose
number depends on the samples are biased (Kirk and Arvo 1991). Without bias, there are two halves with random numbers of their
own. The pilot of each decides how many samples the *other* one gets, once. So no number depends on samples that are averaged
with it, and the mean of both halves is unbiased.

References: kirk-arvo-1991.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import warp as wp

from wrt.imaging.image_files import save_image
from wrt.imaging.integrators.render_settings import RenderSettings
from wrt.imaging.integrators.rendering_job import Rendering
from wrt.kernels.runtime.launch import launch, use_threads
from wrt.kernels.shading.wavefront import picture
from wrt.kernels.validation import as_bool, as_float, as_int
from wrt.tables import one_of

if TYPE_CHECKING:
    from wrt.imaging.sampled_picture import Camera
    from wrt.scene.scene import Scene

SAMPLERS = ("sobol", "halton", "random")
"""Those whose samples do not depend on how many there will be."""

FAR = 1 << 31
"""Between the seeds of two halves. Pixel p of the seed s + 1 has the random numbers of pixel p + 1 of the seed s
(`wrt.pictures.RenderSettings`), so seeds that are near each other are not independent."""

REACH = 1
"""Neighbours on each side over which spread and luminance are averaged."""

DARK = 0.1
"""Share of the picture's mean luminance that is added to that of a pixel: errors in the dark are not pursued without end."""

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


class AdaptiveRendering:
    """A picture whose noisy pixels get more samples than others.

        picture = wrt.pictures.AdaptiveRendering(scene, camera, samples=64, lights=lights).advance()
        picture.image(), picture.counts, picture.noise

    Args:
        scene, camera: as in `Rendering`.
        samples: mean number of samples of a pixel, at least 8.
        unbiased: whether the number of a pixel's samples depends only on samples that are not averaged with them, at the price
            of one decision in place of several.
        pilot: number of samples that each pixel has in any case, at least 4; None for a quarter.
        rounds: number of decisions, at least 1, without `unbiased`.
        most: largest number of samples of a pixel; None for 16 times the mean.
        options: as in `Rendering`, but for `samples` and `motion`.

    Attributes:
        samples: mean number of samples of a pixel when the picture is complete.
        counts: (height, width) int32, samples of each pixel so far.

    Raises:
        TypeError: an argument has a wrong type; an unknown option.
        ValueError: a value out of range, or the sampler "jittered" or "regular", whose samples depend on their number.
    """

    def __init__(
        self,
        scene: Scene,
        camera: Camera,
        *,
        samples: int = 64,
        unbiased: bool = False,
        pilot: int | None = None,
        rounds: int = 4,
        most: int | None = None,
        **options: Any,
    ) -> None:
        if "motion" in options:
            raise TypeError("motion is not for adaptive pictures: their samples are not spread evenly over time; use Rendering")
        self.samples, unbiased = as_int("samples", samples, 8), as_bool("unbiased", unbiased)
        self._pilot = max(4, self.samples // 4) if pilot is None else as_int("pilot", pilot, 4, self.samples)
        self._rounds = 1 if unbiased else as_int("rounds", rounds, 1)
        self._max_samples = 16 * self.samples if most is None else as_int("most", most, self.samples)
        one = Rendering(scene, camera, samples=self._max_samples, **options)
        one_of(SAMPLERS, one.settings.sampler, "sampler")
        self.settings: RenderSettings = one.settings
        self._halves = [one]
        if unbiased:
            settings = {**options, "seed": one.settings.seed + FAR}
            self._halves.append(Rendering(scene, camera, samples=self._max_samples, **settings))
        self._scene, self.camera = scene, camera
        self._counts = np.zeros((len(self._halves), one.pixels), dtype=np.int32)
        self._dither = np.random.default_rng(one.settings.seed).random(one.pixels)

    def __repr__(self) -> str:
        size = f"{self.camera.width} x {self.camera.height}"
        return f"AdaptiveRendering({self._halves[0].integrator!r}, {size}, {self.counts.mean():.1f} of {self.samples} samples)"

    def advance(self, progress: Callable[[int, int], object] | None = None) -> AdaptiveRendering:
        """Adds all samples that are missing, and returns the picture.

        Args:
            progress: called as progress(done, total) in samples of all pixels, after each round.
        """
        halves, goal = len(self._halves), self.samples * self._counts.shape[1]
        if self._counts.any():
            return self
        pixels = np.arange(self._counts.shape[1], dtype=np.int32)
        for number, half in enumerate(self._halves):
            own = (self._pilot + number) // halves
            half._expose_chosen(pixels, 0, own)
            self._counts[number] = own
        first = self._counts.max(axis=1)
        for turn in range(self._rounds):
            left = (goal - int(self._counts.sum())) / (halves * (self._rounds - turn))
            wanted = [self._wanted(number, left) for number in range(halves)][::-1]  # each half decides for the other one
            for number, levels in enumerate(wanted):
                first[number] = self._expose(number, int(first[number]), levels)
            if progress is not None:
                progress(int(self._counts.sum()), goal)
        return self

    def _wanted(self, number: int, total: float) -> np.ndarray:
        """(pixels,) int: how many units of samples each pixel should get, if there are `total` samples, by what a half has
        found."""
        sums, squares = self._halves[number]._collected_sums()
        count, shape = self._counts[number].astype(np.float64), (self.camera.height, self.camera.width)
        mean = sums @ LUMINANCE / count
        spread = np.maximum(squares / count - mean * mean, 0.0)
        near = averaged(mean.reshape(shape)).ravel()
        share = np.sqrt(averaged(spread.reshape(shape)).ravel()) / (near + DARK * max(float(mean.mean()), 1e-30))
        if not share.sum() > 0.0:
            share = np.ones_like(share)
        wanted = shared_out(total, share, np.maximum(self._max_samples / len(self._halves) - count, 0.0))
        return np.floor(wanted / self._unit + self._dither).astype(np.int64)

    @property
    def _unit(self) -> int:
        """Samples that a pixel gets at a time."""
        return max(1, self.samples // 16)

    def _expose(self, number: int, first: int, levels: np.ndarray) -> int:
        """Adds units of samples to pixels of a half, numbered from `first` on; returns the number after the last one."""
        order = np.argsort(-levels, kind="stable").astype(np.int32)
        for level in range(int(levels.max(initial=0))):
            chosen = np.sort(order[: int((levels > level).sum())])
            self._halves[number]._expose_chosen(chosen, first, self._unit)
            self._counts[number, chosen] += self._unit
            first += self._unit
        return first

    @property
    def counts(self) -> np.ndarray:
        return self._counts.sum(axis=0, dtype=np.int32).reshape(self.camera.height, self.camera.width)

    @property
    def linear(self) -> np.ndarray:
        """(height, width, 3) float32, linear: the mean of the samples so far; of two halves, the mean of theirs.

        Raises:
            ValueError: there are no samples.
        """
        self._check()
        mean = np.zeros((self._counts.shape[1], 3))
        for half, count in zip(self._halves, self._counts, strict=True):
            mean += half._collected_sums()[0] / count.astype(np.float64)[:, None]
        return np.float32(mean / len(self._halves)).reshape(self.camera.height, self.camera.width, 3)

    @property
    def noise(self) -> np.ndarray:
        """(height, width) float32: standard error of each pixel's luminance, from the spread of its samples.

        Raises:
            ValueError: there are no samples.
        """
        self._check()
        total = np.zeros(self._counts.shape[1])
        for half, count in zip(self._halves, self._counts, strict=True):
            sums, squares = half._collected_sums()
            mean = sums @ LUMINANCE / count
            total += np.maximum(squares / count - mean * mean, 0.0) / np.maximum(count - 1.0, 1.0)
        return np.float32(np.sqrt(total) / len(self._halves)).reshape(self.camera.height, self.camera.width)

    def image(self, tone_mapping: str | None = None, exposure: float | None = None) -> np.ndarray:
        """(height, width, 3) float32 for display; arguments and errors as in `Rendering.image`."""
        mapping = self.settings.tone_mapping if tone_mapping is None else tone_mapping
        number = picture.TONE_MAPPINGS.index(one_of(picture.TONE_MAPPINGS, mapping, "tone_mapping"))
        factor = self.settings.exposure if exposure is None else as_float("exposure", exposure)
        device = self._scene.device
        mean = wp.array(self.linear.reshape(-1, 3), dtype=wp.vec3, device=device)
        out = wp.empty_like(mean)
        with use_threads(self._scene.num_threads):
            launch(picture.map_tones, len(mean), [mean, 1, float(factor), number, out], device=device, chunk=4096)
        return out.numpy().reshape(self.camera.height, self.camera.width, 3)

    @property
    def layers(self) -> dict[str, np.ndarray]:
        """As in `Rendering.layers`."""
        return self._halves[0].layers

    @property
    def rays(self) -> int:
        """Number of rays traced so far."""
        return sum(half.rays for half in self._halves)

    def save(self, path: str | Path) -> None:
        """Writes the picture for display, or linear to ".npy"; errors as in `wrt.save_image`.

        Args:
            path: of the file; its extension decides.
        """
        save_image(path, self.linear if Path(path).suffix.lower() == ".npy" else self.image())

    def _check(self) -> None:
        if not self._counts.any():
            raise ValueError("the picture has no samples yet; call advance() first")


def shared_out(total: float, share: np.ndarray, room: np.ndarray) -> np.ndarray:
    """(N,) parts of a total in proportion to shares (N,), none above its room (N,); the rest goes to the others."""
    found = np.zeros_like(share)
    for _ in range(32):
        free = (found < room) & (share > 0.0)
        left = total - found.sum()
        if left <= 1e-9 * total or not free.any():
            break
        found = np.where(free, np.minimum(found + left * share / share[free].sum(), room), found)
    return found


def averaged(values: np.ndarray) -> np.ndarray:
    """(height, width): means over squares of 2 `REACH` + 1 pixels, cut at the borders."""
    for axis in (0, 1):
        sums = np.cumsum(np.insert(values, 0, 0.0, axis=axis), axis=axis)
        at = np.arange(values.shape[axis])
        low, high = np.maximum(at - REACH, 0), np.minimum(at + REACH + 1, len(at))
        counted = (high - low).reshape((-1, 1) if axis == 0 else (1, -1))
        values = (np.take(sums, high, axis=axis) - np.take(sums, low, axis=axis)) / counted
    return values
