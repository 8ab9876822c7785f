"""A folder with Python for arm64 and wrt's dependencies."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from importlib.metadata import requires, version
from pathlib import Path

QEMU = "qemu-aarch64-static"
PLATFORMS = ("manylinux_2_34_aarch64", "manylinux_2_28_aarch64", "manylinux_2_27_aarch64", "manylinux2014_aarch64")


class Unavailable(Exception):
    """Something that emulation needs is not to be had here."""


def run(command: list[str]) -> None:
    """Runs a program.

    Raises:
        Unavailable: it is missing or fails.
    """
    try:
        done = subprocess.run(command, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    except FileNotFoundError:
        raise Unavailable(f"{command[0]} is missing") from None
    if done.returncode:
        raise Unavailable(f"{' '.join(command)} failed: {(done.stderr or done.stdout).strip()[-500:]}")


def prepare(folder: Path) -> list[str]:
    """Fills a folder, unless it is filled; returns the command that runs Python in it.

    Raises:
        Unavailable: no root, no Debian, or packages that cannot be fetched.
    """
    root, site, done = folder / "root", folder / "site", folder / "done"
    if not done.exists():
        if os.getuid() != 0:
            raise Unavailable("packages are installed by root only")
        for old in (root, site):
            shutil.rmtree(old, ignore_errors=True)
        if shutil.which(QEMU) is None:
            run(["apt-get", "update", "-qq"])
            run(["apt-get", "install", "-y", "-qq", "--no-install-recommends", "qemu-user-static"])
        unpack_python(folder, root)
        install_wheels(root, site)
        done.touch()
    return [QEMU, "-L", str(root), str(python_of(root))]


def unpack_python(folder: Path, root: Path) -> None:
    """Debian's Python for arm64 with all libraries that it needs. The system's own packages stay as they are."""
    lists, cache, status = folder / "lists", folder / "cache", folder / "status"
    for made in (lists / "partial", cache / "archives" / "partial", root):
        made.mkdir(parents=True, exist_ok=True)
    status.touch()
    settings = ["APT::Architecture=arm64", "APT::Architectures=arm64", f"Dir::State::lists={lists}", f"Dir::Cache={cache}"]
    settings += [f"Dir::State::status={status}", "Debug::NoLocking=1", "APT::Sandbox::User=root"]
    apt = ["apt-get", "-y", "-qq", *(word for setting in settings for word in ("-o", setting))]
    run([*apt, "update"])
    run([*apt, "install", "--download-only", "--no-install-recommends", "python3", "libstdc++6"])
    for package in sorted((cache / "archives").glob("*.deb")):
        run(["dpkg", "-x", str(package), str(root)])


def python_of(root: Path) -> Path:
    """Python in a folder of Debian's packages."""
    return next(iter(sorted((root / "usr" / "bin").glob("python3.[0-9]*[0-9]"))))


def install_wheels(root: Path, site: Path) -> None:
    """What wrt needs, in the versions that are installed here, and what the tests import."""
    names = [line.split(";")[0] for line in requires("wrt") or [] if "extra ==" not in line]
    names = [f"{name}=={version(name)}" for line in names for name in [line.partition("<")[0].partition(">")[0].strip()]]
    platforms = [word for platform in PLATFORMS for word in ("--platform", platform)]
    python = python_of(root).name.removeprefix("python")
    pip = [sys.executable, "-m", "pip", "install", "-q", "--target", str(site), "--only-binary=:all:", *platforms]
    run([*pip, "--python-version", python, *names, "pytest"])
