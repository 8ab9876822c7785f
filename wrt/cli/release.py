"""`wrt release`: makes what is published, in a checkout: a source distribution, and a wheel with compiled kernels.

The kernels are compiled for every target that this CPU can run, each by a process of its own (`wrt warm --export`). They fit
the installed version of Warp alone, so the wheel has the platform tag of Warp's wheel.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence
from importlib.metadata import distribution
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import click

from wrt.cli.number_types import Whole

PURE = "any"
"""Platform of a wheel without compiled kernels."""


@click.command()
@click.option("--out", default="dist", show_default=True, type=click.Path(path_type=Path, file_okay=False), help="Folder.")
@click.option("--target", "targets", multiple=True, help="Target of kernels; may be repeated. [all that this CPU can run]")
@click.option("--first-hit", is_flag=True, help="Only the kernels for building a scene and tracing small batches.")
@click.option("--jobs", type=Whole(1, 64), help="Modules that are compiled at a time. [all cores]")
def release(out: Path, targets: tuple[str, ...], first_hit: bool, jobs: int | None) -> None:
    """Makes a source distribution, and a wheel with compiled kernels for this system, of the checkout that is installed.

    Compiles the kernels of the default paths for each target, so it takes minutes. Another system's wheel is made there: on
    aarch64 the targets are neoverse-n1 and neoverse-v2.
    """
    root = checkout()
    chosen = targets or able_targets()
    check_targets(chosen)
    out = out.absolute()
    with TemporaryDirectory(prefix="wrt-release-") as folder:
        source = copy_source(root, Path(folder) / "source")
        made = [build_sdist(source, out)]
        for target in chosen:
            export_kernels(target, source / "kernels" / "compiled", first_hit=first_hit, jobs=jobs)
        made.append(build_wheel(source, out, platform_of("warp-lang") if chosen else PURE))
    for path in made:
        click.echo(f"{path}: {path.stat().st_size / 1e6:.1f} MB")


def checkout() -> Path:
    """The folder of the checkout that this package is imported from.

    Raises:
        click.UsageError: there is none, or no hatchling, which builds.
    """
    import wrt

    root = Path(wrt.__file__).parents[1]
    if not (root / "pyproject.toml").exists() or not (root / ".git").exists():
        raise click.UsageError("needs a Git checkout of wrt, installed by 'pip install -e .'")
    try:
        import hatchling  # noqa: F401
    except ImportError:
        raise click.UsageError("needs hatchling: pip install 'wrt[release]'") from None
    return root


def able_targets() -> tuple[str, ...]:
    """The targets that this CPU can run, "native" left out."""
    from wrt.kernels.compilation.target import TARGETS, cpu_features

    return tuple(name for name, target in TARGETS.items() if target.needs and target.needs <= cpu_features())


def check_targets(names: Iterable[str]) -> None:
    """Refuses targets for which this CPU cannot compile and try kernels."""
    able = able_targets()
    for name in names:
        if name not in able:
            raise click.BadParameter(f"{name!r} cannot be made here; choose from {', '.join(able)}", param_hint="--target")


def copy_source(root: Path, destination: Path) -> Path:
    """Copies the files of a checkout that Git knows."""
    listed = subprocess.run(["git", "ls-files", "-z"], cwd=root, capture_output=True, check=True).stdout
    for name in filter(None, os.fsdecode(listed).split("\0")):
        if (root / name).is_file():
            target = destination / name
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(root / name, target)
    return destination


def export_kernels(target: str, folder: Path, *, first_hit: bool, jobs: int | None) -> None:
    """Compiles kernels for a target, and copies them to a folder.

    Raises:
        click.ClickException: `wrt warm` failed.
    """
    command = [sys.executable, "-m", "wrt", "warm", "--target", target, "--export", str(folder)]
    command += ["--first-hit"] if first_hit else []
    command += ["--jobs", str(jobs)] if jobs is not None else []
    environment = {name: value for name, value in os.environ.items() if name not in ("WRT_TARGET", "WRT_WIDTH")}
    if subprocess.run(command, env=environment, check=False).returncode:
        raise click.ClickException(f"kernels for {target} could not be compiled")


def platform_of(package: str) -> str:
    """The platform in the tag of an installed wheel, such as "manylinux_2_28_x86_64"."""
    text = distribution(package).read_text("WHEEL") or ""
    tags = [line.partition(":")[2].strip() for line in text.splitlines() if line.startswith("Tag:")]
    return ".".join(dict.fromkeys(tag.rpartition("-")[2] for tag in tags)) or PURE


def build_sdist(source: Path, out: Path) -> Path:
    """Makes a source distribution of a folder; its path."""
    from hatchling.builders.sdist import SdistBuilder

    return _built(SdistBuilder(str(source)), out)


def build_wheel(source: Path, out: Path, platform: str) -> Path:
    """Makes a wheel of a folder, with the kernels that are in `kernels/compiled`; its path.

    Args:
        source: the folder.
        out: where to.
        platform: in the wheel's tag; "any" for a wheel without compiled kernels.
    """
    from hatchling.builders.wheel import WheelBuilder

    class TaggedBuilder(WheelBuilder):
        """A builder of wheels for a platform and every Python 3."""

        def get_default_build_data(self) -> dict[str, Any]:
            return {**super().get_default_build_data(), "tag": f"py3-none-{platform}", "pure_python": platform == PURE}

    return _built(TaggedBuilder(str(source)), out)


def _built(builder: Any, out: Path) -> Path:
    made: Sequence[str] = [*builder.build(directory=str(out), versions=["standard"])]
    return Path(made[0])
