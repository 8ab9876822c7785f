"""What all tasks of a batch share: the scene in a file, and a small pickle of everything else. Each process reads them once.

The client writes the scene once (`Scene.save`; scenes that cannot be saved are pickled) and sends its path and hash with each
task, some hundred bytes. A worker keeps the scenes that it used last. It takes a file only if its hash is the one that was
sent: another file at the same path is an error, and wrong answers cannot come of it. `scatter` of Dask is not used: it drops
    replicas.
"""

from __future__ import annotations

import hashlib
import pickle
import secrets
import shutil
import tempfile
import threading
import weakref
from collections import OrderedDict
from collections.abc import Callable
from copy import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from wrt.atomic_files import replaced
from wrt.query.batches.workers import WarpSettings, Workers, process_device

KEPT = 4
"""Number of shared objects that a process keeps."""

_lock = threading.RLock()
_kept: OrderedDict[Any, Any] = OrderedDict()
_written: weakref.WeakKeyDictionary[Any, dict[str, SharedScene]] = weakref.WeakKeyDictionary()
"""Files of this process by the state of a scene and by folder. An updated scene has another state."""

received: dict[str, str] = {}
"""Files that this process was sent: path by hash."""


def kept(key: Any, make: Callable[[], Any]) -> Any:
    """An object that this process keeps, made the first time; the one that was used longest ago makes room."""
    with _lock:
        if key not in _kept:
            _kept[key] = make()
            while len(_kept) > KEPT:
                _kept.popitem(last=False)
        _kept.move_to_end(key)
        return _kept[key]


@dataclass(frozen=True)
class SharedScene:
    """A scene in a file.

    Attributes:
        path: of the file.
        hash: SHA-256 of the file.
        load: what reads the file, given the path and `device`; None if it is a pickle.
        device: name of the device of the scene that was saved.
        settings: the client's settings of Warp.
    """

    path: str
    hash: str
    load: Callable[..., Any] | None
    device: str
    settings: WarpSettings

    def get(self, device: str | None) -> Any:
        """The scene in this process.

        Args:
            device: as `wrt.cluster.Workers.device`.

        Raises:
            FileNotFoundError, ValueError: no such file here, or another one.
        """
        chosen = process_device(device, self.device)
        return kept((self.hash, chosen), lambda: self._read(chosen))

    def _read(self, device: str) -> Any:
        self.settings.use()
        path = Path(received.get(self.hash, self.path))
        if not path.is_file():
            raise FileNotFoundError(
                f"the worker does not see the scene file '{path}'; pass executor=wrt.cluster.Workers(executor, folder=...) "
                "with a folder that the client and all workers share"
            )
        if file_hash(path) != self.hash:
            raise ValueError(f"'{path}' is not the scene that the batch began with; another program wrote there")
        if self.load is not None:
            return self.load(path, device=device)
        function, arguments = pickle.loads(path.read_bytes())
        geometry, options, *others = arguments
        return function(geometry, options | {"device": device, "num_threads": None}, *others)


def share_scene(scene: Any, folder: str | Path | None) -> SharedScene:
    """Writes a scene to a file for workers, once for each state and folder.

    Args:
        scene: the scene.
        folder: a folder for the file; None for a temporary one, which is removed with the scene or the process.

    Raises:
        OSError: the file cannot be written.
        ValueError: the scene can neither be saved nor pickled.
    """
    scene = copy(scene)  # whatever becomes of the caller's, one state is written
    with _lock:
        files, key = _written.setdefault(scene.state, {}), str(folder)
        if key in files and Path(files[key].path).is_file():
            return files[key]
        if folder is None:
            place = Path(tempfile.mkdtemp(prefix="wrt-scene-"))
            weakref.finalize(scene.state, shutil.rmtree, place, ignore_errors=True)
        else:
            place = Path(folder)
            place.mkdir(parents=True, exist_ok=True)
        path, load = place / f".scene-{secrets.token_hex(8)}", type(scene).load
        try:
            scene.save(path)
        except ValueError:
            load = None
            function, arguments = scene.__reduce__()[:2]
            with replaced(path) as file:
                file.write(pickle.dumps((function, arguments)))
        content_hash = file_hash(path)
        named = path.with_name(f"scene-{content_hash}.{'pickle' if load is None else 'npz'}").absolute()
        path.replace(named)
        files[key] = SharedScene(str(named), content_hash, load, str(scene.device), WarpSettings.here())
        return files[key]


def file_hash(path: Path) -> str:
    """SHA-256 of a file's bytes."""
    state = hashlib.sha256()
    with path.open("rb") as file:
        while piece := file.read(1 << 20):
            state.update(piece)
    return state.hexdigest()


def dumps(value: Any) -> bytes:
    """A pickle; of functions without a name by cloudpickle, where that is installed.

    Raises:
        TypeError: a part cannot be pickled.
    """
    try:
        from cloudpickle import dumps as by_value
    except ImportError:
        by_value = pickle.dumps
    try:
        return by_value(value)
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise TypeError(
            f"a part of the batch cannot be sent to other processes ({error}); use functions of a module"
        ) from error


def deliver_scene(workers: Workers, shared: SharedScene) -> bool:
    """Sends the scene's file to Dask workers that do not see it, also to those that join later.

    Returns:
        Whether workers see the scene's folder.
    """
    client = workers.client
    if client is None or workers.folder is not None:
        return True
    seen = client.run(is_visible, shared.path)
    if seen and all(seen.values()):
        return True
    client.register_plugin(scene_plugin(shared), name=f"wrt-{shared.hash}")
    return False


def is_visible(path: str) -> bool:
    """Whether a worker sees a file."""
    return Path(path).is_file()


def scene_plugin(shared: SharedScene) -> Any:
    """A plugin for Dask workers that brings them a scene's file."""
    from distributed import WorkerPlugin

    class BringScene(WorkerPlugin):
        """Writes the file into the worker's own folder."""

        def __init__(self) -> None:
            self.hash, self.suffix, self.data = shared.hash, Path(shared.path).suffix, Path(shared.path).read_bytes()

        def setup(self, worker: Any) -> None:
            from wrt.query.batches import shared_files

            path = Path(worker.local_directory) / f"wrt-scene-{self.hash}{self.suffix}"
            with replaced(path) as file:
                file.write(self.data)
            shared_files.received[self.hash] = str(path)

    return BringScene()
