"""The pictures of the guide to the live view, taken in a browser: `python docs/screenshots.py [NAME...]`.

It needs viser (`wrt[view]`), Playwright and Chromium.
"""

from __future__ import annotations

import io
import shutil
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from playwright.sync_api import Browser, Page, sync_playwright

import wrt
from wrt import scenes

IMAGES = Path(__file__).resolve().parent / "images"
ARGUMENTS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox")
WINDOW, SHOWN = (960, 600), (720, 450)


class Shot:
    """A page of a viewer."""

    def __init__(self, browser: Browser, scene: wrt.Scene, view: dict[str, Any], **options: Any) -> None:
        camera = wrt.PinholeCamera(*WINDOW, **view)
        self.viewer = wrt.view(scene, block=False, port=0, camera=camera, up=view.get("up"), **options)
        self.page: Page = browser.new_page(viewport=dict(zip(("width", "height"), WINDOW, strict=True)))
        self.page.goto(self.viewer.url)
        self.wait(lambda: self.viewer.panels)
        (self.session,), ((self.controls, self.pick, self.tree),) = self.viewer.sessions.values(), self.viewer.panels.values()
        self.settle()
        for close in self.page.locator(".mantine-Notification-closeButton").all():
            close.click()

    def wait(self, true: Callable[[], Any]) -> None:
        while not true():
            self.page.wait_for_timeout(50)

    def settle(self) -> None:
        self.page.wait_for_timeout(500)
        self.wait(lambda: self.session.is_idle)
        self.page.wait_for_timeout(800)

    def open(self, *folders: str) -> None:
        """Opens parts of the panel, or closes open ones."""
        for folder in folders:
            self.page.get_by_text(folder, exact=True).locator("visible=true").first.click()
            self.page.wait_for_timeout(300)

    def save(self, name: str) -> None:
        self.settle()
        image = Image.open(io.BytesIO(self.page.screenshot())).convert("RGB").resize(SHOWN, Image.Resampling.LANCZOS)
        image.quantize(256, kmeans=3, dither=Image.Dither.NONE).save(IMAGES / f"{name}.png", optimize=True)
        self.viewer.close()
        self.page.close()


def cost(browser: Browser) -> None:
    """The cost of each ray."""
    shot = atrium(browser)
    shot.controls._look.value = "cost: nodes"
    shot.save("live_view_cost")


def pick(browser: Browser) -> None:
    """A picked ray, and the boxes on its way."""
    shot = atrium(browser)
    shot.open("Pick")
    shot.page.mouse.click(230, 330)
    shot.wait(lambda: shot.pick.hits is not None)
    shot.save("live_view_pick")


def trees(browser: Browser) -> None:
    """A BVH and a kd-tree side by side."""
    scene = wrt.Scene(scenes.build("teapot", level=8, ground=False))
    low, high = scene.bounds
    middle = (low + high) / 2 + ((high - low)[0] * 1.25, 0.0, 0.0)
    view = {"fov": 40.0, "position": np.add(middle, (0.5, -21.0, 7.0)), "look_at": middle, "up": (0.0, 0.0, 1.0)}
    shot = Shot(browser, scene, view, samples=2)
    shot.open("Picture", "Tree")
    shot.tree._shows.value = True
    shot.tree._tree.value = "BVH and kd-tree side by side"
    shot.tree._level.value = 2
    shot.wait(lambda: "kdtree" in shot.tree._text.content)
    shot.save("live_view_trees")


def instances(browser: Browser) -> None:
    """The gizmo of an instance, and the traversal path of a ray through both levels."""
    pot = scenes.build("teapot", level=8, ground=False)
    placed = [wrt.Instance(pot)]
    for number, (x, y, turn) in enumerate(((-7.0, 1.0, 0.6), (5.5, 3.0, -0.8), (-2.0, 7.0, 2.0))):
        matrix = np.eye(4)
        c, s = np.cos(turn), np.sin(turn)
        matrix[:3, :3] = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]) * (0.9 + 0.15 * number)
        matrix[:3, 3] = x, y, 0.0
        placed.append(wrt.Instance(pot, matrix))
    view = {"fov": 40.0, "position": (3.5, -23.0, 10.0), "look_at": (3.5, 0.0, 1.0), "up": (0.0, 0.0, 1.0)}
    shot = Shot(browser, wrt.Scene(placed), view, samples=2)
    shot.open("Picture", "Pick")
    shot.viewer._panel._instance.value = 1
    shot.viewer._panel._moves.value = True
    shot.page.mouse.click(420, 300)
    shot.wait(lambda: shot.pick.hits is not None)
    shot.save("live_view_instances")


def areas(browser: Browser) -> None:
    """The octree over two influence areas."""
    mesh, name = scenes.build("teapot", level=8, ground=False), "octree of areas"
    view = {"direction": (0.0, 0.2, -1.0), "fov": (40.0, 30.0), "near": 0.2, "far": 9.0}
    lamps = [wrt.known_rays.PointInfluenceArea(position=(x, -1.0, 7.0), **view) for x in (-4.0, 3.0)]
    scene = wrt.Scene(mesh, wrt.known_rays.RayAwareBvh(areas=lamps, top_level="octree", depth=4))
    view = {"fov": 40.0, "position": (7.0, -26.0, 8.0), "look_at": (5.0, 0.0, 2.0), "up": (0.0, 0.0, 1.0)}
    shot = Shot(browser, scene, view, samples=2)
    shot.open("Picture", "Tree")
    shot.tree._shows.value = True
    shot.tree._tree.value = name
    shot.tree._measure.value = "triangles"
    shot.tree._level.value = 3
    shot.wait(lambda: name in shot.tree._text.content)
    shot.save("live_view_areas")


def atrium(browser: Browser) -> Shot:
    known = scenes.BUILTIN_SCENES["atrium"]
    options = {"ambient": {"light": known.light, "ambient_distance": 4.0}}  # else its cloister is dark
    return Shot(browser, wrt.Scene(scenes.build("atrium")), known.camera | {"up": known.up}, samples=2, options=options)


SHOTS = {"cost": cost, "pick": pick, "trees": trees, "instances": instances, "areas": areas}


def main() -> None:
    """Takes the pictures that are named, or all."""
    path = next(found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name)))
    with sync_playwright() as started:
        browser = started.chromium.launch(executable_path=path, args=[*ARGUMENTS])
        for name in sys.argv[1:] or SHOTS:
            SHOTS[name](browser)
        browser.close()


if __name__ == "__main__":
    main()
