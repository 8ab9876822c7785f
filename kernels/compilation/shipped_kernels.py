"""Kernels that were compiled in advance and lie in a folder, such as the one of a wheel: loaded in place of compiling them.

    FOLDER/x86-64-v3/made_for.txt       Warp's version, system and compiler
    FOLDER/x86-64-v3/KEY.o, KEY.meta    a module's code, and Warp's data about it
    FOLDER/x86-64-v3/KEY.o.seal         a checksum of both

`wrt warm --export FOLDER` writes them. They are looked for in `wrt.kernels`' own folder `compiled`, or where
WRT_COMPILED_KERNELS says, when the kernel cache does not have a module.

**When they fit.** The key is a hash of what Warp hashes for its own cache: the source of all kernels of the module, with all
functions and constants that they use, and the options of the compiler except the CPU. So a change of a kernel, of the number of
lanes or of an option leads to another key, and the module is compiled as ever. Warp's version, system and compiler must be
exactly those of `made_for.txt`. Nothing else is trusted but the folder itself: its code is run.

**Which target.** Without WRT_TARGET, the highest target that this CPU can run: hits are the same to the bit, as no kernel
fuses operations (`wrt.kernels.runtime.options`). With WRT_TARGET only that target, and none for "native".
"""

import hashlib
import os
import shutil
import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path

import warp as wp

from wrt.kernels.compilation.damaged_kernels import damage_of, seal
from wrt.kernels.compilation.kernel_cache import cached_files
from wrt.kernels.compilation.target import (
    TARGET_VARIABLE,
    TARGETS,
    cpu_features,
    split_flags,
    target_flags,
    target_name,
)

VARIABLE = "WRT_COMPILED_KERNELS"

MADE_FOR = "made_for.txt"

CPU_BLOCK = 1
"""Threads of a block on the CPU."""

_loaded: set[str] = set()
_refused: set[str] = set()


def folder() -> Path:
    """Where shipped kernels are looked for; need not exist."""
    return Path(os.environ.get(VARIABLE) or Path(__file__).parents[1] / "compiled")


def loaded_count() -> int:
    """Shipped modules that this process has loaded."""
    return len(_loaded)


def targets() -> tuple[str, ...]:
    """Targets whose shipped kernels this process may use, the best first."""
    asked = os.environ.get(TARGET_VARIABLE)
    wanted = [target_name()] if asked else ["native"]
    if split_flags(wp.config.cpu_compiler_flags or "-march=native")[0] != list(target_flags(wanted[0])):
        return ()
    if not asked:
        wanted = [name for name, target in reversed(TARGETS.items()) if target.needs <= cpu_features()]
    return tuple(name for name in wanted if name != "native" and _fits(folder() / name, name))


def find(module: wp.Module, device: wp.Device, block_dim: int) -> tuple[Path, Path] | None:
    """Code of a module and the data about it, in the folder of shipped kernels; None if there are none that fit."""
    if not device.is_cpu or block_dim != CPU_BLOCK or module.options["cpu_compiler_flags"] is not None:
        return None
    able = targets()
    key = key_of(module) if able else ""
    for name in able:
        code, about = (folder() / name / f"{key}{ending}" for ending in (".o", ".meta"))
        if key not in _refused and code.exists() and about.exists():
            damage = damage_of(code, about)
            if damage is None:
                return code, about
            _refuse(code, damage)
    return None


def _refuse(code: Path, reason: object) -> None:
    """Does without a module's shipped code, and says so on stderr."""
    _refused.add(code.stem)
    print(f"wrt: '{code}' cannot be loaded ({reason}); its kernels are compiled instead", file=sys.stderr)


def load(module: wp.Module, device: wp.Device, block_dim: int) -> bool:
    """Loads a module's shipped code; False if there is none that fits, or it cannot be loaded."""
    found = find(module, device, block_dim)
    if found is None:
        return False
    code, about = found
    try:
        module.load(device, block_dim=block_dim, binary_path=code, meta_path=about)
    except Exception as error:
        _refuse(code, error)
        return False
    _loaded.add(code.stem)
    return True


def key_of(module: wp.Module) -> str:
    """Hash of a module's kernels and of its options, except those that choose the CPU."""
    module.get_module_hash(CPU_BLOCK)
    options = dict(module.resolved_options[CPU_BLOCK])
    options["cpu_compiler_flags"] = split_flags(options["cpu_compiler_flags"])[1]
    content = hashlib.sha256()
    for kernel in sorted(module.hashers[CPU_BLOCK].unique_kernels):
        content.update(kernel)
    for name in sorted(options):
        content.update(f"{name}:{options[name]}\n".encode())
    return content.hexdigest()


def export(modules: Iterable[wp.Module], destination: Path) -> int:
    """Copies compiled modules from the kernel cache, for the current target; returns how many.

    Raises:
        ValueError: the target is "native": code for this CPU alone.
        FileNotFoundError: the kernel cache does not have a module.
    """
    name, device = target_name(), wp.get_device("cpu")
    if name == "native":
        raise ValueError("kernels for the target 'native' are for this CPU alone; choose another one, such as x86-64-v3")
    modules = set(modules)
    place = destination / name
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir(parents=True)
    for module in modules:
        code, about = cached_files(module, device, CPU_BLOCK)
        shutil.copyfile(code, place / f"{key_of(module)}.o")
        shutil.copyfile(about, place / f"{key_of(module)}.meta")
        seal(*(place / f"{key_of(module)}{ending}" for ending in (".o", ".meta")))
    (place / MADE_FOR).write_text(_made_for(name), encoding="utf-8")
    return len(modules)


def _made_for(name: str) -> str:
    return wp.get_cpu_kernel_cache_key(cpu_compiler_flags=" ".join(TARGETS[name].flags))


@cache
def _fits(place: Path, name: str) -> bool:
    """Whether kernels in a folder were compiled by this version of Warp, for this system."""
    try:
        return (place / MADE_FOR).read_text(encoding="utf-8") == _made_for(name)
    except OSError:
        return False
