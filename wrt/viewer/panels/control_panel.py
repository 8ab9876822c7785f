"""The control panel of one client: what to look at, how rays are traced, and what the pictures cost."""

from __future__ import annotations

from collections import deque
from time import perf_counter
from typing import Any

import numpy as np

from wrt.imaging.integrators import INTEGRATORS
from wrt.kernels.traversal import TRAVERSALS
from wrt.kernels.traversal.packet import CULLINGS
from wrt.kernels.triangle import TRIANGLE_TESTS
from wrt.viewer.client_session import ClientSession
from wrt.viewer.frame_loop import FrameTimes
from wrt.viewer.pictures.looks import BEAUTY, LOOKS

__all__ = ["ControlPanel"]

AUTO = "auto"

WRITE_EVERY, PLOT_EVERY = 0.25, 0.5
"""Seconds between changes of the figures and of the plot, while pictures come."""

PLOTTED = 120
"""Pictures of the plot."""


class ControlPanel:
    """The controls of a client, and the figures below them.

    Args:
        session: the client's.
    """

    def __init__(self, session: ClientSession) -> None:
        self._session, gui = session, session.client.gui
        self._written = self._plotted = 0.0
        self._times: deque[tuple[float, FrameTimes]] = deque(maxlen=PLOTTED)
        self._rates: deque[float] = deque(maxlen=PLOTTED)
        request = session.request
        with gui.add_folder("Picture"):
            self._look = gui.add_dropdown("Look", [*LOOKS], initial_value=request.look)
            self._integrator = gui.add_dropdown("Integrator", INTEGRATORS, initial_value=request.integrator)
            self._samples = gui.add_slider("Samples", min=1, max=256, step=1, initial_value=request.samples)
            self._scale = gui.add_markdown("", visible=False)
            self._bar = gui.add_image(color_bar(), format="png", visible=False)
            self._problem = gui.add_markdown("", visible=False)
            self._figures = gui.add_markdown("")
        with gui.add_folder("Rays", expand_by_default=False):
            self._traversal = gui.add_dropdown("Traversal", [AUTO, *TRAVERSALS], initial_value=request.traversal)
            hint = "Of camera rays in packets; not of light."
            self._culling = gui.add_dropdown("Culling", [AUTO, *CULLINGS], initial_value=request.culling, hint=hint)
            self._test = gui.add_dropdown("Triangle test", [AUTO, *TRIANGLE_TESTS], initial_value=request.triangle_test)
        with gui.add_folder("Time", expand_by_default=False):
            self._plot = self._new_plot(gui)
        fields = {
            "look": self._look,
            "integrator": self._integrator,
            "samples": self._samples,
            "traversal": self._traversal,
            "culling": self._culling,
            "triangle_test": self._test,
        }
        for field, control in fields.items():
            control.on_update(self._changer(field))
        session.on_shown, session.on_error = self.show_times, self.show_error
        if session.times is not None:
            self.show_times(session.times)
        if session.error is not None:
            self.show_error(session.error)

    def _changer(self, field: str) -> Any:
        async def change(event: Any) -> None:
            value = event.target.value
            self._session.change(**{field: int(value) if field == "samples" else value})
            if field == "look":
                self._integrator.disabled = self._samples.disabled = value != BEAUTY

        return change

    def _new_plot(self, gui: Any) -> Any:
        from viser import uplot

        empty = np.zeros(1)
        series = (
            uplot.Series(label="picture"),
            uplot.Series(label="ms", stroke="#2a6fdb", width=2),
            uplot.Series(label="Mrays/s", stroke="#d9822b", width=2),
            uplot.Series(label="pictures/s", stroke="#2f9e44", width=2),
        )
        return gui.add_uplot((empty,) * 4, series, title="the last pictures", aspect=1.6)

    def show_times(self, times: FrameTimes) -> None:
        """Writes what a picture took; called after each."""
        now = perf_counter()
        self._times.append((now, times))
        self._rates.append(self.rate() if times.is_coarse else np.nan)
        if now - self._written >= WRITE_EVERY or times.is_complete:
            self._written = now
            self._figures.content = self._text(times)
            self._show_scale()
        if now - self._plotted >= PLOT_EVERY or times.is_complete:
            self._plotted = now
            shown = [one for _, one in self._times]
            count = np.arange(len(shown), dtype=np.float64)
            milliseconds = np.array([1e3 * one.seconds for one in shown])
            speed = np.array([one.rays / max(one.seconds, 1e-9) / 1e6 for one in shown])
            self._plot.data = (count, milliseconds, speed, np.array(self._rates))

    def _text(self, times: FrameTimes) -> str:
        width, height = (max(1, round(side * times.scale)) for side in self._session.request.size)
        lines = [
            f"{width} x {height}, {1e3 * times.seconds:.0f} ms, {times.rays / max(times.seconds, 1e-9) / 1e6:.1f} Mrays/s",
            f"{self.rate():.0f} pictures/s" if times.is_coarse else ("complete" if times.is_complete else "refining"),
        ]
        return "  \n".join(lines)

    def rate(self) -> float:
        """Pictures a second, of the last second of movement."""
        recent = [at for at, one in self._times if one.is_coarse and perf_counter() - at < 1.0]
        return (len(recent) - 1) / (recent[-1] - recent[0]) if len(recent) > 1 else 0.0

    def _show_scale(self) -> None:
        scale = getattr(self._session.picture, "scale", None)
        self._bar.visible = scale is not None and scale.unit != "distance"
        self._scale.visible = scale is not None
        if scale is not None:
            self._scale.content = f"{scale.unit}: **{scale.low:.4g}** to **{scale.high:.4g}**, mean {scale.mean:.4g}"

    def show_error(self, error: Exception | None) -> None:
        """Says why there is no picture; None for no reason."""
        if error is not None:
            self._problem.content = f"**{type(error).__name__}**: {error}"
        self._problem.visible = error is not None  # last: a reader in another thread who sees it finds the words


def color_bar() -> np.ndarray:
    """(12, 256, 3) uint8: the colours of costs, from the least to the largest."""
    import warp as wp

    from wrt.kernels.runtime.launch import launch
    from wrt.kernels.shading import false_color

    shares = wp.array(np.linspace(0.0, 1.0, 256, dtype=np.float32), dtype=float, device="cpu")
    image = wp.empty(256, dtype=wp.vec3, device="cpu")
    launch(false_color.color_values, 256, [shares, 0.0, 1.0, image], device=wp.get_device("cpu"), chunk=256)
    return np.repeat(np.rint(image.numpy() * 255.0).astype(np.uint8)[None], 12, axis=0)
