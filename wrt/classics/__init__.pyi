# Written by `python -m tests.typed.stubs` from the table of names in wrt/classics/__init__.py.
from wrt.classics.fan_scene import FanScene as FanScene

__all__ = [
    "FanScene",
]
