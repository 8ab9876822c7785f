"""Where `import wrt` finds the package: in a checkout, beside one, and anywhere else."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

CHECKOUT = Path(__file__).parents[2]


def where(folder: Path) -> str:
    """The file that `import wrt` loads in a fresh interpreter that is started in the folder."""
    code = "import wrt, wrt.kernels.runtime, wrt.builders; print(wrt.Scene.__name__, wrt.__file__)"
    ran = subprocess.run([sys.executable, "-W", "ignore", "-c", code], cwd=folder, capture_output=True, text=True, check=True)
    name, file = ran.stdout.split(maxsplit=1)
    assert name == "Scene"
    return file.strip()


def test_the_folder_above_a_checkout(tmp_path):
    """A folder named wrt without an __init__.py is a namespace package, which hid the one that pip had installed as editable:
    `import wrt` succeeded there, and wrt had no Scene. An installed package on the import path comes before namespaces."""
    (tmp_path / "wrt" / "wrt").mkdir(parents=True)
    assert where(tmp_path).endswith("__init__.py")


def test_the_root_of_a_checkout():
    """Its wrt/ is imported from where it is, its kernels/ and builders/ from beside it, installed or not."""
    assert Path(where(CHECKOUT)) == CHECKOUT / "wrt" / "__init__.py"
