"""Pictures beyond `wrt.render` and `wrt.view`: samples in steps, settings of integrators, trees as drawings.

    picture = wrt.pictures.Rendering(scene, camera, integrator="path", lights=lights, samples=256)
    while picture.done < picture.samples:
        picture.advance(16)
        wrt.save_image("preview.png", picture.image())

`AmbientRendering` is the default integrator of `wrt.render` in the same steps, and `Viewer` what `wrt.view` returns.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "AdaptiveRendering": "wrt.imaging.integrators.adaptive_rendering",
    "AmbientRendering": "wrt.imaging.ambient_rendering",
    "RenderSettings": "wrt.imaging.integrators.render_settings",
    "Rendering": "wrt.imaging.integrators.rendering_job",
    "Viewer": "wrt.viewer.live_view",
    "draw_tree": "wrt.viewer.trees.tree_drawing",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
