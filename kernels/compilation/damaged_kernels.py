"""Compiled kernels that were damaged on disk: found before they run, and removed.

A disk that ran full, a copy that was cut short or a bad sector leave files that are no longer what was compiled. Warp's loader
refuses most of them with an error; a few changed bytes it does not notice, and the process dies when they run. So a file beside
the code, its *seal*, has a checksum of the code and of the data about it. It is written when a module is first loaded, and read
before it is loaded again. It guards against accidents, not against people.

Removing means renaming the module's folder, so that no other process sees half of it, and then deleting what can be deleted.
"""

import os
import shutil
import sys
import tempfile
import zlib
from contextlib import suppress
from pathlib import Path

_sound: set[Path] = set()
_has_warned = False


def seal_of(code: Path) -> Path:
    """The file with the checksum of a module's code."""
    return code.with_name(f"{code.name}.seal")


def checksum(code: Path, about: Path) -> str:
    """Checksum and size of a module's code, and of the data about it."""
    contents = code.read_bytes(), about.read_bytes()
    return " ".join(f"{zlib.crc32(content):08x} {len(content)}" for content in contents)


def seal(code: Path, about: Path) -> None:
    """Writes the seal of a module, unless there is one or the folder is not writable."""
    _sound.add(code)
    place = seal_of(code)
    with suppress(OSError):
        if not place.exists():
            handle, name = tempfile.mkstemp(dir=code.parent)
            with open(handle, "w", encoding="ascii") as file:
                file.write(checksum(code, about))
            os.replace(name, place)


def damage_of(code: Path, about: Path) -> str | None:
    """What is wrong with a module's files; None if they are as they were sealed, or not sealed. Compared once in a process."""
    if code in _sound:
        return None
    try:
        sealed = seal_of(code).read_bytes()
    except OSError:
        return None
    try:
        if checksum(code, about).encode() != sealed:
            return f"the checksum of '{code.name}' has changed"
    except OSError as error:
        return str(error)
    _sound.add(code)
    return None


def remove(folder: Path, reason: object) -> None:
    """Removes the folder of a damaged module, and says so on stderr the first time.

    Raises:
        OSError: it cannot be renamed.
    """
    global _has_warned
    aside = Path(tempfile.mkdtemp(prefix="damaged-", dir=folder.parent))
    try:
        os.rename(folder, aside / folder.name)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
    _sound.difference_update([path for path in _sound if path.parent == folder])
    if not _has_warned:
        _has_warned = True
        print(
            f"wrt: compiled kernels in '{folder.parent}' are damaged ({folder.name}: {reason}); these, and any others like "
            "them, are removed and compiled again",
            file=sys.stderr,
        )
