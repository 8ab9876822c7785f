"""Runs a kernel over N items: by the thread pool on the CPU, by one launch on CUDA.

Warp runs a CPU kernel on the calling thread and releases the interpreter lock meanwhile. Items are therefore divided into
contiguous chunks, which the caller and the helpers of the pool claim in native code (`wrt.kernels.runtime.pool`). Chunks shrink
towards the end, so that all threads finish at about the same time (Polychronopoulos and Kuck 1987). The caller works too, so a
nested call never waits for itself, and small batches stay on the calling thread. On systems without native helpers, Python
threads do the same; that scales to about four threads (notebooks/records/2026-11-22-launches.md).

Every kernel launched here has `first: int` as its first parameter and works on item `first + wp.tid()`. The result of an item
must not depend on the other items; chunks and threads then never change a result.

During graph capture on the CPU, all items are one launch.

A `PreparedLaunch` keeps a kernel with its packed arguments for repeated use: the element of a launch cache.

References: polychronopoulos-kuck-1987.
"""

import os
import re
import threading
from collections import deque
from collections.abc import Callable, Container, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, TypeVar

import warp as wp

from wrt.kernels.compilation import module_compiler
from wrt.kernels.compilation.cores import available_cores
from wrt.kernels.compilation.kernel_cache import init_warp
from wrt.kernels.compilation.local_memory import reserve_local_memory
from wrt.kernels.runtime import pool as native
from wrt.kernels.runtime.argument_packing import PackedKernel
from wrt.kernels.runtime.cuda_commands import launch_again
from wrt.kernels.runtime.options import CUDA_BLOCK, cuda_block
from wrt.kernels.runtime.schedules import DEFAULT_SCHEDULE, SCHEDULES
from wrt.kernels.validation import as_int

Config = TypeVar("Config")

CHUNKS_PER_THREAD = 8
"""Number of chunks per thread that determines the size of the first chunks."""

MAX_CHUNK = 1 << 16
"""Greatest number of items in a chunk of rays or triangles: about 10 ms of work."""

MIN_CHUNK_SHARE = 16
"""The last chunks are this many times smaller than the first ones."""

MAX_THREADS = 1024
"""Greatest number of threads that can be set."""

_lock = threading.RLock()
_loaded: set[tuple[wp.Kernel, str]] = set()
_executor: ThreadPoolExecutor | None = None
_num_threads: int | None = None
_default_threads: int | None = None  # kept: beside a large query, a look at the affinity mask takes 10 us
_local_threads: ContextVar[int | None] = ContextVar("wrt_threads", default=None)
_schedule: ContextVar[str] = ContextVar("wrt_schedule", default=DEFAULT_SCHEDULE)


def get_num_threads() -> int:
    """Number of threads that CPU kernels use: `use_threads`, else `set_num_threads`, else WRT_NUM_THREADS, else all cores.

    The variable and the cores are looked at once, again after `set_num_threads`, and again in a forked child.

    Raises:
        ValueError: WRT_NUM_THREADS is not a whole number from 1 to 1024.
    """
    global _default_threads
    if (local := _local_threads.get()) is not None:
        return local
    if _num_threads is not None:
        return _num_threads
    if _default_threads is None:
        text = os.environ.get("WRT_NUM_THREADS", "").strip()
        if text and not text.isdigit():
            raise ValueError(f"WRT_NUM_THREADS is {text!r}; set it to a whole number from 1 to {MAX_THREADS}")
        _default_threads = check_num_threads(int(text), "WRT_NUM_THREADS") if text else available_cores()
    return _default_threads


def set_num_threads(count: int | None) -> None:
    """Sets the number of threads that CPU kernels use from now on; None restores the default.

    Raises:
        TypeError: `count` is not an int.
        ValueError: `count` is not from 1 to 1024.
    """
    global _num_threads, _default_threads
    _num_threads, _default_threads = None if count is None else check_num_threads(count, "count"), None


class use_threads:  # a class, because a generator would take three times as long, and every query enters one
    """Sets the number of threads for launches of the calling thread inside the `with` block; None changes nothing."""

    __slots__ = ("_count", "_token")

    def __init__(self, count: int | None) -> None:
        self._count = count

    def __enter__(self) -> None:
        self._token = _local_threads.set(_local_threads.get() if self._count is None else self._count)

    def __exit__(self, *error: object) -> None:
        _local_threads.reset(self._token)


def check_num_threads(count: int, name: str) -> int:
    """Returns `count` if it is a valid number of threads; raises an error that names `name` otherwise."""
    return as_int(name, count, 1, MAX_THREADS)


def launch(
    kernel: wp.Kernel,
    count: int,
    inputs: Sequence[Any],
    *,
    device: wp.Device,
    chunk: int = 256,
    longest: int = MAX_CHUNK,
    chunks_per_thread: int = CHUNKS_PER_THREAD,
) -> None:
    """Runs `kernel` for the items 0 .. count - 1. The launch is not recorded by a `wp.Tape`.

    Args:
        kernel: a kernel whose first parameter is `first: int`, the number of the first item of the chunk.
        count: number of items.
        inputs: the other arguments of the kernel.
        device: device of the arguments; on CUDA this is one launch on the device's current stream.
        chunk: on the CPU, least number of items in a chunk.
        longest: on the CPU, greatest number of items in a chunk. Lower it for items that take long, because a Ctrl-C takes
            effect only after the running chunks.
        chunks_per_thread: on the CPU, number of chunks per thread that determines the first chunk size. Lower it for items of
            equal cost, whose chunks then have one size; raise it for few, long and uneven items.
    """
    if count <= 0:
        return
    load([kernel], device)
    if device.is_cuda:
        launch_again(kernel, count, [0, *inputs], device, cuda_block(kernel))
        return
    if device.is_capturing:
        wp.launch(kernel, dim=count, inputs=[0, *inputs], device=device, record_tape=False)
    else:
        chunks = Chunks(chunk, longest, chunks_per_thread)
        PreparedLaunch(kernel, inputs, device).run(count, chunks)


@dataclass(frozen=True)
class Chunks:
    """The division of items into chunks on the CPU; attributes as the arguments of `launch`."""

    chunk: int = 256
    longest: int = MAX_CHUNK
    chunks_per_thread: int = CHUNKS_PER_THREAD

    def sizes(self, count: int, threads: int) -> tuple[int, int]:
        """Items of the largest and of the smallest chunk of `count` items."""
        if threads == 1:
            return min(count, self.longest), min(count, self.longest)
        chunks = min(self.chunks_per_thread * threads, -(-count // self.chunk))
        largest = min(-(-count // max(1, chunks)), self.longest)
        falls = self.chunks_per_thread >= CHUNKS_PER_THREAD
        return largest, min(largest, max(self.chunk, -(-largest // MIN_CHUNK_SHARE))) if falls else largest


class PreparedLaunch:
    """A kernel with packed arguments for repeated launches on the CPU; used by one caller at a time.

    Args:
        kernel, inputs, device: as in `launch`.
    """

    def __init__(self, kernel: wp.Kernel, inputs: Sequence[Any], device: wp.Device) -> None:
        load([kernel], device)
        self._packed = PackedKernel(kernel, [0, *inputs], device)
        self._last: tuple[tuple[Any, ...], native.Job] | None = None  # job of the last run, and what it was made for

    def argument(self, index: int) -> Any:
        """The packed form of a struct argument. Values that are written to it take effect at the next run."""
        return self._packed.argument(index)

    def set_value(self, index: int, value: int | float) -> None:
        """Replaces a number among the arguments; the number of the first item is argument 0."""
        setattr(self._packed.arguments, f"p{index}", value)

    def replace(self, index: int, struct: Any) -> None:
        """Replaces an argument that is a struct; `index` as in `argument`."""
        self._packed.replace(index, struct)

    def update(self, inputs: Sequence[Any]) -> None:
        """Replaces the arguments; `PackedKernel.update`."""
        self._packed.update([0, *inputs])

    def forget(self, but: Container[int]) -> None:
        """`PackedKernel.forget`."""
        self._packed.forget(but)

    def run(self, count: int, chunks: Chunks, used: Any = None, threads: int | None = None) -> None:
        """Runs the kernel for the items 0 .. count - 1.

        Args:
            count: number of items.
            chunks: division of the items.
            used: owners of memory whose addresses were written into the arguments. They are kept alive until the last helper is
                done, even if the caller is interrupted again while it waits.
            threads: `get_num_threads()`, if the caller knows it.
        """
        if count <= min(chunks.chunk, chunks.longest):
            self._packed.call_own_range(0, count)
            return
        threads, schedule = threads or get_num_threads(), _schedule.get()
        key = count, chunks, threads, schedule
        if self._last is not None and self._last[0] == key:  # `chunks` is the same object in most cases
            native.the_pool().run(self._last[1], (self._packed, used))
            return
        largest, smallest = chunks.sizes(count, threads)
        threads = min(threads, -(-count // smallest))
        if threads == 1:
            for first in range(0, count, largest):
                self._packed.call_own_range(first, min(largest, count - first))
        elif native.is_available():
            job, memory = native.new_job(
                self._packed, count, max_chunk=largest, min_chunk=smallest, threads=threads, schedule=SCHEDULES[schedule]
            )
            self._last = None if SCHEDULES[schedule].queues else (key, job)  # queues are used up
            native.the_pool().run(job, (memory, used))
        else:
            self._run_in_python(count, largest, used)

    def _run_in_python(self, count: int, largest: int, used: Any) -> None:
        """Runs the kernel with chunks that Python hands out."""

        def run(number: int) -> None:
            first = number * largest
            self._packed.call_range(first, min(largest, count - first))

        run.used = used
        run_tasks(run, -(-count // largest))
        del run.used  # now: the pool may keep the function alive for a while


@contextmanager
def use_schedule(name: str) -> Iterator[None]:
    """Sets the schedule (a key of `SCHEDULES`) for launches of the calling thread inside the `with` block.

    Raises:
        ValueError: `name` is not a key of `SCHEDULES`.
    """
    if name not in SCHEDULES:
        raise ValueError(f"schedule {name!r} is not known; choose from {', '.join(SCHEDULES)}")
    token = _schedule.set(name)
    try:
        yield
    finally:
        _schedule.reset(token)


@contextmanager
def kept(device: wp.Device) -> Iterator[None]:
    """Context for allocations that outlive a query and are shared by all threads, streams and graphs.

    During a graph capture, an allocation would belong to the graph and would be filled only when the graph is launched.

    Raises:
        RuntimeError: a graph is being captured on the device.
    """
    if device.is_capturing:
        raise RuntimeError(
            "a graph is being captured, but data that the query caches is not ready yet; "
            "make the same query once before the capture"
        )
    yield
    if device.is_cuda:
        wp.synchronize_stream(device.stream)


def refuse_capture(what: str, device: wp.Device) -> None:
    """Refuses what reads on the host what kernels compute: while a graph is captured, kernels are recorded and do not run.

    Args:
        what: the subject of the message, such as "update".
        device: where the kernels would run; trees are built on the CPU as well.

    Raises:
        RuntimeError: a graph is being captured there.
    """
    if device.is_capturing or (device.is_cuda and wp.get_device("cpu").is_capturing):
        raise RuntimeError(
            f"{what} cannot be part of a graph: kernels do not run while it is captured, and their results are needed at once; "
            "call it before or after the capture"
        )


def load_changed(kernel: wp.Kernel, device: wp.Device) -> None:
    """Reloads the module of a kernel if it has gained specialisations.

    A kernel with `Any` parameters gains one for each new type.
    """
    module_compiler.load_modules([kernel.module], device, 1 if device.is_cpu else cuda_block(kernel))


def load(kernels: Sequence[wp.Kernel], device: wp.Device) -> None:
    """Compiles the modules of kernels side by side and loads them, once, however many threads call this at the same time."""
    for kernel in kernels:
        if (kernel, device.alias) not in _loaded:
            break
    else:
        return
    if device.is_cpu:
        module_compiler.load_modules([kernel.module for kernel in kernels], device, 1)
    else:
        for kernel in kernels:
            module_compiler.load_modules([kernel.module], device, cuda_block(kernel))
            reserve_local_memory(kernel, device, cuda_block(kernel))
    _loaded.update((kernel, device.alias) for kernel in kernels)


def expect(kernels: Iterable[wp.Kernel], device: wp.Device) -> None:
    """Begins to compile the modules of kernels that will be needed soon, and does not wait for them.

    Costs nothing for kernels that are loaded, and little for those that the kernel cache has.
    """
    wanted = [kernel.module for kernel in kernels if (kernel, device.alias) not in _loaded]
    if wanted:
        module_compiler.expect(wanted, device, 1 if device.is_cpu else CUDA_BLOCK)


def needs_no_compiling(kernel: wp.Kernel, device: wp.Device) -> bool:
    """Whether a kernel for the CPU is loaded, in the kernel cache, or shipped."""
    return (kernel, device.alias) in _loaded or module_compiler.needs_no_compiling(kernel.module, device, 1)


def specialise(factory: Callable[[Config], wp.Kernel], config: Config) -> wp.Kernel:
    """The kernel that a factory makes for a configuration; one thread at a time calls the factory.

    Two threads that call it at the same time would create its structs twice, and values of the one type do not fit the other.
    """
    with _lock:
        return factory(config)


def run_tasks(task: Callable[[int], Any], count: int) -> None:
    """Calls `task(0)` .. `task(count - 1)` on the caller's thread and the pool's threads; returns when all are done.

    After the first exception (including KeyboardInterrupt) no further task is started; the exception is raised when the running
    tasks have ended.
    """
    helpers = min(get_num_threads(), count) - 1
    if helpers <= 0:
        for number in range(count):
            task(number)
        return
    pending = deque(range(count))

    def work() -> None:
        while True:
            try:
                number = pending.popleft()
            except IndexError:
                return
            try:
                task(number)
            except BaseException:
                pending.clear()
                raise

    futures: list[Future[None]] = [_pool().submit(work) for _ in range(helpers)]
    try:
        work()
    finally:
        pending.clear()
        for future in futures:
            future.cancel()
        wait(futures)
    for future in futures:
        if not future.cancelled():
            future.result()


def _pool() -> ThreadPoolExecutor:
    global _executor
    with _lock:
        if _executor is None:
            _executor = ThreadPoolExecutor(MAX_THREADS, thread_name_prefix="wrt")
        return _executor


def _forget_pool() -> None:
    """Resets the pool in a forked child, which has none of its threads, and may get other cores."""
    global _executor, _lock, _default_threads
    _executor, _lock, _default_threads = None, threading.RLock(), None


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_forget_pool)


def as_device(device: str | wp.Device | None) -> wp.Device:
    """The device of that name; Warp's default device for None.

    Args:
        device: a Warp device, or a name as any library writes it, in capitals or not: "cpu", "CPU:0" (Open3D), "cuda",
            "cuda:1", "GPU:0"; or another library's device whose text is such a name, as those of Open3D and PyTorch.

    Raises:
        TypeError: no name of a device.
        ValueError: the device does not exist.
    """
    init_warp()
    if device is not None and not isinstance(device, wp.Device):
        device = _device_name(device)
    try:
        return wp.get_device(device)
    except (ValueError, RuntimeError) as error:
        raise ValueError(f"device {device!r} does not exist ({error}); choose from {_device_names()}") from None


def _device_name(device: Any) -> str:
    """Warp's name of a device."""
    match = _DEVICE.fullmatch(str(device).strip())
    if match is None:
        kind = ValueError if isinstance(device, str) else TypeError
        raise kind(f"device {device!r} does not exist; choose from {_device_names()}")
    kind, number = match["kind"].lower(), match["number"]
    if kind == "cpu":
        if number is not None and int(number):
            raise ValueError(f"device {device!r} does not exist: all cores are one device; pass 'cpu'")
        return kind
    return "cuda" if number is None else f"cuda:{int(number)}"


def _device_names() -> str:
    return ", ".join(str(one) for one in wp.get_devices())


_DEVICE = re.compile(r"(?P<kind>cpu|cuda|gpu)(?::(?P<number>\d{1,4}))?", re.IGNORECASE)
"""Names of devices."""
