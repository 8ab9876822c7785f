# Written by `python -m tests.typed.stubs` from the table of names in wrt/pictures.py.
from wrt.imaging.ambient_rendering import AmbientRendering as AmbientRendering
from wrt.imaging.integrators.adaptive_rendering import AdaptiveRendering as AdaptiveRendering
from wrt.imaging.integrators.render_settings import RenderSettings as RenderSettings
from wrt.imaging.integrators.rendering_job import Rendering as Rendering
from wrt.viewer.live_view import Viewer as Viewer
from wrt.viewer.trees.tree_drawing import draw_tree as draw_tree

__all__ = [
    "AdaptiveRendering",
    "AmbientRendering",
    "RenderSettings",
    "Rendering",
    "Viewer",
    "draw_tree",
]
