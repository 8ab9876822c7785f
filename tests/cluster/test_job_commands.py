"""`wrt job` and what its files may hold: one line says what is wrong; nothing is written where it should not be."""

from __future__ import annotations

import json
import os
import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import wrt
from wrt.cli import main
from wrt.cluster.job_file import run_job_file
from wrt.cluster.job_file_keys import KEYS

RAYS = '[rays]\norigins = "origins.npy"\ndirections = [0, 0, 1]\n'
JOB = 'folder = "job"\n[scene]\nfile = "scene.npz"\ndevice = "cpu"\n'
NEAREST = 'query = "closest_point"\n' + JOB + '[points]\npositions = "origins.npy"\n'
FUNCTION = 'folder = "job"\n[scene]\nfile = "scene.npz"\n[rays]\nshape = [20]\nfunction = "rays.py:rays"\n'
PRECIOUS = "years of work"


@pytest.fixture(scope="module")
def files(tmp_path_factory) -> Path:
    """A folder with a scene and some rays."""
    place = tmp_path_factory.mktemp("files")
    wrt.Scene(wrt.scenes.build("teapot", level=2), device="cpu").save(place / "scene.npz")
    np.save(place / "origins.npy", np.random.default_rng(0).normal(size=(20, 3)))
    return place


@pytest.fixture
def place(files, tmp_path) -> Path:
    return Path(shutil.copytree(files, tmp_path / "place"))


def called(*arguments: str | Path) -> str:
    """The line on stderr of a command that fails."""
    done = CliRunner().invoke(main, list(map(str, arguments)))
    assert done.exit_code in (1, 2), done.output
    assert isinstance(done.exception, SystemExit), repr(done.exception)
    assert done.output.startswith("error: ")
    assert done.output.count("\n") == 1
    return done.output


def fails(place: Path, text: str | bytes) -> str:
    """What `wrt job run` says of a job file with this text; it makes no folder for the job."""
    (place / "job.toml").write_bytes(text if isinstance(text, bytes) else text.encode())
    line = called("job", "run", place / "job.toml")
    assert not (place / "job").exists()
    return line


WRONG = {
    b"\xff\xfe": "not a TOML file",
    b"folder = " + b"[" * 5000: "not a TOML file",
    "folder = 3\n" + JOB.split("\n", 1)[1] + RAYS: "folder in .* must be a text, not 3",
    'folder = ""\n' + JOB.split("\n", 1)[1] + RAYS: "folder in .* must be a text",
    'folder = "a\\u0000b"\n' + JOB.split("\n", 1)[1] + RAYS: "folder in .* must be a text",
    "query = 3\n" + JOB + RAYS: "query in .* is 3; choose from intersect, occluded, count",
    "memory = -3\n" + JOB + RAYS: "memory in .* is wrong: memory is -3",
    "memory = 1.5\n" + JOB + RAYS: "memory in .* is wrong: memory must be an int",
    "memory = true\n" + JOB + RAYS: "memory in .* is wrong: memory must be an int",
    "memory = nan\n" + JOB + RAYS: "memory in .* is wrong",
    f'memory = "{"9" * 400}"\n' + JOB + RAYS: "memory in .* is wrong",
    'attributes = "t"\n' + JOB + RAYS: "attributes in .* must be a list of texts",
    'attributes = ["t", "depth"]\n' + JOB + RAYS: "attributes in .* is 'depth'; choose from t, ",
    'attributes = ["t"]\n' + JOB + RAYS: "attributes is for closest hits",
    "options = 3\n" + JOB + RAYS: "options in .* must be a table",
    JOB + RAYS + "[options]\nexecutor = 3": r"the key 'executor' in \[options\]",
    JOB + RAYS + "[options]\nmask = -1": r"\[options\] mask in .* must be a whole number from 0 to 4294967295",
    JOB + RAYS + "[options]\nmask = 1.0": r"\[options\] mask in .* must be a whole number from .*, not 1.0",
    JOB + RAYS + "[options]\nprecise = true": "precise in .* is for query = 'intersect' or 'closest_point'",
    JOB + RAYS + "[points]\nmax_distance = 2": r"\[points\] max_distance in .* is for query = 'closest_point'",
    NEAREST.replace("positions", "# positions"): r"needs \[points\] positions",
    NEAREST + RAYS: r"\[rays\] origins in .* is for rays",
    NEAREST + '[options]\ntraversal = "single"': r"\[options\] traversal in .* is for rays",
    NEAREST + "max_distance = -1": r"\[points\] max_distance in .* must be a number of at least 0",
    NEAREST.replace("origins.npy", "cut.npy"): r"\[points\] positions: .* is not an array of NumPy, or is damaged",
    NEAREST + '[reduce]\nby = "max"': "must be a table such as",
    JOB + RAYS + '[options]\ntraversal = "magic"': "traversal",
    JOB + RAYS + '[options]\ntriangle_test = "magic"': "triangle_test",
    JOB + 'accelerator = "bvh"\n' + RAYS: "accelerator is for mesh files",
    JOB + "threads = 0\n" + RAYS: r"\[scene\] threads in .* is wrong",
    JOB + "threads = 2.0\n" + RAYS: r"\[scene\] threads in .* is wrong",
    JOB.replace("cpu", "cuda:77") + RAYS: "device 'cuda:77' does not exist",
    JOB.replace("scene.npz", "no.npz") + RAYS: "no scene file at",
    JOB.replace("scene.npz", "no.ply") + RAYS: "no mesh file at",
    JOB.replace("scene.npz", "origins.npy") + RAYS: "origins.npy",
    JOB.replace("scene.npz", "pipe.npz") + RAYS: "no scene file at",
    JOB.replace("scene.npz", "pipe.ply") + RAYS: "is a pipe, not a regular file",
    JOB: "needs origins and directions",
    JOB + RAYS + "t_min = -1": r"\[rays\] t_min in .* must be a finite number of at least 0",
    JOB + RAYS + "t_min = inf": r"\[rays\] t_min in .* must be a finite number of at least 0",
    JOB + RAYS + "t_max = nan": r"\[rays\] t_max in .* must be a number of at least 0",
    JOB + RAYS + 't_max = "far"': r"\[rays\] t_max in .* must be a number",
    JOB + RAYS + "t_max = true": r"\[rays\] t_max in .* must be a number",
    JOB + RAYS + f"t_max = 1{'0' * 400}": r"\[rays\] t_max in .* must be a number",
    JOB + RAYS + "t_min = 3\nt_max = 2": r"\[rays\] t_min in .* is above t_max",
    JOB + RAYS + "outer = 1": r"\[rays\] outer in .* must be true or false",
    JOB + RAYS + "shape = 3": "has a shape and no function",
    JOB + RAYS + 'function = "rays.py:rays"': "has a function and arrays",
    JOB
    + '[rays]\norigins = 3\ndirections = "origins.npy"': r"\[rays\] origins in .* must be a path, or vectors of three numbers",
    JOB + '[rays]\norigins = [[0, 0]]\ndirections = "origins.npy"': r"\[rays\] origins in .* must be a path, or vectors",
    JOB + '[rays]\norigins = [[0, 0, nan]]\ndirections = "origins.npy"': r"\[rays\] origins in .* must be a path, or vectors",
    JOB + '[rays]\norigins = [["a", 0, 0]]\ndirections = "origins.npy"': r"\[rays\] origins in .* must be a path, or vectors",
    JOB + f'[rays]\norigins = [1{"0" * 400}, 0, 0]\ndirections = "origins.npy"': r"\[rays\] origins in .* must be a path",
    JOB + '[rays]\norigins = [[[0, 0, 0]], [0, 0, 0]]\ndirections = "origins.npy"': "must have the same length",
    JOB + '[rays]\norigins = {parquet = 3}\ndirections = "origins.npy"': r"\[rays\] origins in .* must be a table such as",
    JOB + '[rays]\norigins = {parquet = "no", columns = ["x"]}\ndirections = "origins.npy"': "there is no parquet file",
    JOB + '[rays]\norigins = {parquet = "pipe.npy", columns = ["x"]}\ndirections = "origins.npy"': "there is no parquet file",
    JOB + '[rays]\norigins = "pipe.npy"\ndirections = "origins.npy"': r"must be a \.npy file",
    JOB + '[rays]\norigins = "/dev/zero"\ndirections = "origins.npy"': r"must be a \.npy file",
    JOB + '[rays]\norigins = "pipe.zarr"\ndirections = "origins.npy"': r"must be a \.npy file",
    JOB + '[rays]\norigins = "empty.zarr"\ndirections = "origins.npy"': "is not an array of zarr|need zarr",
    JOB + '[rays]\norigins = "cut.npy"\ndirections = "origins.npy"': "is not an array of NumPy, or is damaged",
    JOB + '[rays]\norigins = "objects.npy"\ndirections = "origins.npy"': "is not an array of NumPy, or is damaged",
    JOB + '[rays]\norigins = "text.npy"\ndirections = "origins.npy"': "does not hold an array of real numbers",
    JOB + '[rays]\norigins = "archive.npy"\ndirections = "origins.npy"': "does not hold an array of real numbers",
    FUNCTION.replace("[20]", "[-1]"): r"\[rays\] shape in .* must be the number of rows",
    FUNCTION.replace("[20]", "2.5"): r"\[rays\] shape in .* must be the number of rows",
    FUNCTION.replace("[20]", "[]"): r"\[rays\] shape in .* must be the number of rows",
    FUNCTION.replace("[20]", "true"): r"\[rays\] shape in .* must be the number of rows",
    FUNCTION.replace("[20]", f"1{'0' * 30}"): r"\[rays\] shape in .* must be the number of rows",
    FUNCTION.replace("shape = [20]\n", ""): "has a function and no shape",
    FUNCTION.replace("rays.py:rays", "rays.py"): "give a file and a function",
    FUNCTION.replace("rays.py:rays", "pipe.npy:rays"): "give a file and a function",
    FUNCTION.replace(":rays", ":nothing"): "has no function 'nothing'",
    FUNCTION.replace(":rays", ":number"): "has no function 'number'",
    FUNCTION.replace(":rays", ":breaks"): "failed: KeyError: 'missing'",
    FUNCTION.replace("rays.py:", "wrong.py:"): "is not Python",
    FUNCTION.replace("rays.py:", "fails.py:"): "failed: ZeroDivisionError",
    JOB + RAYS + "[reduce]\naxis = 0": "has an axis and no by",
    JOB + RAYS + '[reduce]\nby = "sum"\naxis = 0.5': r"\[reduce\] axis in .* must be a whole number, or a list",
    JOB + RAYS + '[reduce]\nby = "sum"\naxis = 7': "axis is 7",
    JOB + RAYS + '[reduce]\nby = "average"': r"\[reduce\] by in .* is 'average'; choose from sum",
    JOB + RAYS + "[reduce]\nby = 3": r"\[reduce\] by in .* is 3; choose from sum",
    JOB + RAYS + '[reduce]\nby = {t = "min"}': "must be one name, such as 'sum' for this query",
    'query = "intersect"\n' + JOB + RAYS + '[reduce]\nby = "min"': "must be a table such as",
    'query = "intersect"\n' + JOB + RAYS + '[reduce]\nby = {depth = "min"}': "must have keys among t, ",
    JOB + RAYS + "[executor]\nworkers = 0": r"\[executor\] workers in .* is wrong",
    JOB + RAYS + '[executor]\nkind = "threads"\nworkers = "many"': r"\[executor\] workers in .* is wrong",
    JOB + RAYS + '[executor]\nkind = "threads"\nretries = -1': r"\[executor\] retries in .* must be a whole number from 0",
    JOB + RAYS + '[executor]\nkind = "processes"\ndevices = []': r"\[executor\] devices in .* must be a list of texts",
    JOB + RAYS + '[executor]\nkind = "dask"': "either address or scheduler_file|needs Dask",
    JOB + RAYS + '[executor]\nkind = "dask"\nscheduler_file = "pipe.npy"': "not a regular file|needs Dask",
    JOB + RAYS + "[output]\nfile = 3": r"\[output\] file in .* must be a text",
}
"""Texts of job files, and what is said of them."""


@pytest.fixture
def traps(place) -> Path:
    """Files that are no arrays, no code, or pipes, which nobody writes to."""
    for name in ("pipe.npz", "pipe.ply", "pipe.npy", "pipe.zarr"):
        os.mkfifo(place / name)
    (place / "empty.zarr").mkdir()
    (place / "cut.npy").write_bytes((place / "origins.npy").read_bytes()[:200])
    np.save(place / "objects.npy", np.array([{"a": 1}], dtype=object), allow_pickle=True)
    np.save(place / "text.npy", np.array(["a", "b", "c"]))
    with (place / "archive.npy").open("wb") as file:
        np.savez(file, a=np.zeros(3))
    (place / "rays.py").write_text("number = 3\ndef breaks(first, count):\n    return {}['missing']\n")
    (place / "wrong.py").write_text("def rays(:\n")
    (place / "fails.py").write_text("1 / 0\n")
    return place


@pytest.mark.parametrize("number", range(len(WRONG)))
def test_what_is_wrong_with_a_job_file_is_a_line(traps, number):
    """Several ended in a traceback, and pipes were waited for without an end."""
    text, message = list(WRONG.items())[number]
    line = fails(traps, text)
    assert re.search(message, line), line


def test_job_files_that_are_no_files(place):
    os.mkfifo(place / "job.toml")
    assert "not a regular file" in called("job", "run", place / "job.toml")
    assert "does not exist" in called("job", "run", place / "nothing.toml")
    (place / "large.toml").write_text("a" * (1 << 24) + " = 1\n")
    assert "more than 16,777,216 bytes" in called("job", "run", place / "large.toml")


@pytest.mark.parametrize(
    ("manifest", "message"),
    [(None, "has no job"), ("{", "cannot be read"), ('{"format": 3}', "it has no id"), ("[" * 100_000, "cannot be read")],
)
def test_status_of_what_is_no_job(place, manifest, message):
    """A manifest without some of its fields ended in a traceback."""
    (place / "job").mkdir()
    if manifest is not None:
        (place / "job" / "manifest.json").write_text(manifest)
    for command in ("status", "run"):
        assert message in called("job", command, place / "job")


def test_a_folder_that_cannot_be_made(place):
    (place / "file").write_text(PRECIOUS)
    (place / "job.toml").write_text(JOB.replace('"job"', '"file/job"') + RAYS)
    assert "file" in called("job", "run", place / "job.toml")
    (place / "job.toml").write_text(JOB.replace('"job"', '"file"') + RAYS)
    assert "file" in called("job", "run", place / "job.toml")
    assert (place / "file").read_text() == PRECIOUS


OUTPUTS = {
    "../thesis.npy": "outside of",
    "/{outside}/thesis.npy": "outside of",
    "link/thesis.npy": "outside of",
    "linked.npy": "outside of",
    "job.toml": r"a name that ends in \.npy",
    "thesis": r"a name that ends in \.npy",
    "thesis.npy": "not a file of NumPy",
    "pipe.npy": "not a regular file",
}


@pytest.mark.parametrize("output", OUTPUTS)
def test_output_stays_in_its_folder(place, output):
    """A stranger's job file replaced any file with its output: `file = "../../.bashrc"`."""
    outside = place.parent
    (outside / "thesis.npy").write_text(PRECIOUS)
    (place / "thesis.npy").write_text(PRECIOUS)
    (place / "link").symlink_to(outside)
    (place / "linked.npy").symlink_to(outside / "thesis.npy")
    os.mkfifo(place / "pipe.npy")
    (place / "job.toml").write_text(JOB + RAYS + f'[output]\nfile = "{output.format(outside=str(outside)[1:])}"\n')
    before = (place / "job.toml").read_text()
    line = called("job", "run", place / "job.toml")
    assert re.search(OUTPUTS[output], line), line
    assert ("--allow-output-outside" in line) == ("outside" in OUTPUTS[output])
    assert not (place / "job").exists()
    assert (outside / "thesis.npy").read_text() == (place / "thesis.npy").read_text() == PRECIOUS
    assert (place / "job.toml").read_text() == before
    folder = JOB.replace('"job"', '"../elsewhere"') + RAYS
    (place / "job.toml").write_text(folder)
    assert "folder is '../elsewhere', outside of" in called("job", "run", place / "job.toml")
    (place / "job.toml").write_text(JOB + RAYS + '[executor]\nkind = "threads"\nfolder = "/elsewhere"\n')
    assert "[executor] folder is '/elsewhere', outside of" in called("job", "run", place / "job.toml")
    assert not (outside / "elsewhere").exists()


def test_output_outside_where_that_is_allowed(place):
    """Also then, only files of NumPy are replaced; attributes of closest hits go into a folder."""
    outside = place.parent
    np.save(outside / "dark.npy", np.zeros(3))
    text = JOB.replace('"job"', '"../elsewhere"') + RAYS + '[output]\nfile = "../dark.npy"\n'
    (place / "job.toml").write_text(text)
    done = CliRunner().invoke(main, ["job", "run", "--allow-output-outside", str(place / "job.toml")])
    assert done.exit_code == 0, done.output
    assert np.load(outside / "dark.npy").shape == (20,)
    assert (outside / "elsewhere" / "manifest.json").is_file()
    (outside / "dark.npy").write_text(PRECIOUS)
    assert "not a file of NumPy" in called("job", "run", "--allow-output-outside", place / "job.toml")
    assert (outside / "dark.npy").read_text() == PRECIOUS
    (place / "hits").mkdir()
    (place / "hits" / "t.npy").write_text(PRECIOUS)
    (place / "job.toml").write_text('query = "intersect"\n' + JOB + RAYS + '[output]\nfile = "hits"\n')
    with pytest.raises(ValueError, match=r"hits/t\.npy', which is not a file of NumPy"):
        run_job_file(place / "job.toml", False)
    (place / "hits" / "t.npy").unlink()
    run_job_file(place / "job.toml", False)
    assert np.load(place / "hits" / "t.npy").dtype == np.float32


def test_the_command_that_goes_on_with_a_job(place):
    """`wrt job status` named `wrt job run`, which took no folder. It takes one beside whose job file it is."""
    (place / "job.toml").write_text(JOB + RAYS)
    (place / "other.toml").write_text(JOB.replace('"job"', '"another"') + RAYS)
    (place / "wrong.toml").write_text("[[")
    run_job_file(place / "job.toml", False)
    (place / "job" / "chunks" / "0000" / "0000000.npz").unlink()
    shown = CliRunner().invoke(main, ["job", "status", str(place / "job")])
    assert shown.exit_code == 0
    assert f"not running: wrt job resume {place / 'job'} goes on with it" in shown.output
    for command in ("run", "resume"):
        (place / "job" / "chunks" / "0000" / "0000000.npz").unlink(missing_ok=True)
        done = CliRunner().invoke(main, ["job", command, str(place / "job")])
        assert done.exit_code == 0, done.output
        assert "1 of 1 blocks" in done.stdout
        assert " rays of " in done.stderr  # a line of progress: this is no terminal
    assert json.loads(CliRunner().invoke(main, ["job", "status", "--json", str(place / "job")]).output)["done"] == 1
    (place / "job" / "chunks" / "0000" / "0000000.npz").unlink()
    (place / "job.toml").rename(place.parent / "job.toml")
    assert "no job file beside it names it" in called("job", "run", place / "job")
    assert "no job file beside it names it" in called("job", "resume", place / "job")
    shown = CliRunner().invoke(main, ["job", "status", str(place / "job")])
    assert "the script or the job file that began it goes on with it" in shown.output
    assert "has no job" in called("job", "run", place)


def test_weights_of_a_job_file(place):
    """Sums in groups; an error names the table, and weights of another query are refused."""
    np.save(place / "suns.npy", np.random.default_rng(1).normal(size=(6, 3)))
    months = np.arange(6) % 2 == np.arange(2)[:, None]
    np.save(place / "months.npy", np.int64(months))
    given = JOB + '[rays]\norigins = "origins.npy"\ndirections = "suns.npy"\nouter = true\n[output]\nfile = "sums.npy"\n'
    (place / "job.toml").write_text(given + '[reduce]\nby = "sum"\naxis = 1\nweights = "months.npy"\n')
    run_job_file(place / "job.toml", False)
    scene = wrt.Scene.load(place / "scene.npz", device="cpu")
    dark = scene.occluded(np.load(place / "origins.npy")[:, None], np.load(place / "suns.npy"))
    np.testing.assert_array_equal(np.load(place / "sums.npy"), dark @ months.T.astype(float))
    shutil.rmtree(place / "job")
    assert "[reduce] weights" in fails(place, given + '[reduce]\nby = "mean"\naxis = 1\nweights = "months.npy"\n')
    assert "there is no file" in fails(place, given + '[reduce]\nby = "sum"\naxis = 1\nweights = "none.npy"\n')


def test_closest_points(place):
    """Of points in a file: distances and triangles, in float64 if that is asked for."""
    scene, points = wrt.Scene.load(place / "scene.npz", device="cpu"), np.load(place / "origins.npy")
    limit = float(np.median(scene.closest_point(points).distance))
    for precise in ("false", "true"):
        rest = f'max_distance = {limit}\n[options]\nprecise = {precise}\n[output]\nfile = "near"\n'
        (place / "job.toml").write_text('attributes = ["t", "primitive_id"]\n' + NEAREST + rest)
        run_job_file(place / "job.toml", progress=False)
        expected = scene.closest_point(points, max_distance=limit, precise=precise == "true")
        assert 0 < expected.is_hit.sum() < len(points)
        np.testing.assert_array_equal(np.load(place / "near" / "t.npy"), expected.distance)
        np.testing.assert_array_equal(np.load(place / "near" / "primitive_id.npy"), expected.primitive_id)
        shutil.rmtree(place / "job")


def test_every_key_is_checked():
    """No value of a kind that nobody means passes any check."""
    for keys in KEYS.values():
        for check in keys.values():
            for value in (None, float("nan"), -1, [], [[]], {1: 2}, object(), ""):
                if check.__name__ != "table" or not isinstance(value, dict):
                    assert isinstance(check(value), str)
                    assert check(value) or (value == -1 and check(-64))
