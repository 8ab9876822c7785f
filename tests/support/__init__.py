"""Helpers of tests: no test module imports another; what several need is here (`from support.meshes import SCENES`)."""

import sys
from pathlib import Path

if "pytest" in sys.modules:  # the documentation is built without it
    _modules = [f"{__name__}.{path.stem}" for path in Path(__file__).parent.glob("*.py")]
    sys.modules["pytest"].register_assert_rewrite(*_modules)
