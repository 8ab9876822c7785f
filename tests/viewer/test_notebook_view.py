"""The viewer in a notebook: a kernel of Jupyter runs the cells, and a browser shows what they give."""

import re
import shutil

import pytest

pytest.importorskip("viser", reason="the viewer needs viser: pip install 'wrt[view]'")
nbclient = pytest.importorskip("nbclient", reason="the notebook needs nbclient: pip install 'wrt[notebooks]'")
nbformat = pytest.importorskip("nbformat", reason="the notebook needs nbformat: pip install 'wrt[notebooks]'")
pytest.importorskip("ipykernel", reason="the notebook needs ipykernel: pip install 'wrt[notebooks]'")

MAKE = """
import wrt
from wrt import scenes
scene = wrt.Scene(scenes.build("teapot", level=4), device="cpu")
options = {"ambient": {"ambient_samples": 2}}
"""

SHOW = """
viewer = wrt.view(scene, port=0, samples=1, options=options)
viewer
"""

WAIT = """
import time
end = time.perf_counter() + 60
while not (viewer.sessions and all(session.is_idle for session in viewer.sessions.values())) and time.perf_counter() < end:
    time.sleep(0.05)
[session.picture.pixels().shape for session in viewer.sessions.values()]
"""


@pytest.fixture(scope="module")
def notebook():
    """Runs cells behind those that show a viewer: run(source) -> outputs. `run.shown` are the outputs of these."""
    made = nbformat.v4.new_notebook()
    client = nbclient.NotebookClient(made, timeout=120)

    def run(source):
        cell = nbformat.v4.new_code_cell(source)
        made.cells.append(cell)
        return client.execute_cell(cell, len(made.cells) - 1).outputs

    with client.setup_kernel():
        run(MAKE)
        run.shown = run(SHOW)
        yield run
        run("viewer.close()")


def text_of(outputs, kind):
    (found,) = (output["data"][kind] for output in outputs if kind in output.get("data", {}))
    return found


def test_shows_itself_in_the_cell(notebook):
    """`wrt.view` returns at once in a notebook, and what it returns is shown as a frame with its address."""
    outputs = notebook.shown
    assert len(outputs) == 1  # viser's greeting used to come first
    frame = text_of(outputs, "text/html")
    url = re.search('src="([^"]+)"', frame)[1]
    assert frame.startswith("<iframe ")
    assert f"Viewer('{url}', 0 clients)" == text_of(outputs, "text/plain")


def test_the_frame_shows_pictures(notebook):
    """In a page of another origin, as notebooks are."""
    playwright = pytest.importorskip("playwright.sync_api", reason="Playwright drives the browser: pip install playwright")
    path = next((found for name in ("chromium", "chromium-browser", "google-chrome") if (found := shutil.which(name))), None)
    if path is None:
        pytest.skip("no Chromium is installed: apt-get install chromium")
    frame = text_of(notebook("viewer"), "text/html")
    with playwright.sync_playwright() as started:
        arguments = ["--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--no-sandbox"]
        browser = started.chromium.launch(executable_path=path, args=arguments)
        page = browser.new_page(viewport={"width": 800, "height": 640})
        page.set_content(f"<h3>A notebook</h3>{frame}")
        page.frame_locator("iframe").locator("canvas").first.wait_for(timeout=60_000)
        shown = text_of(notebook(WAIT), "text/plain")
        assert re.fullmatch(r"\[\(\d+, 7\d\d, 3\)\]", shown), shown
        assert "600" in shown
        browser.close()
