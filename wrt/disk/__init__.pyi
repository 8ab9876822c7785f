# Written by `python -m tests.typed.stubs` from the table of names in wrt/disk/__init__.py.
from wrt.disk.partitioned_hits import PartitionedHits as PartitionedHits
from wrt.disk.partitioned_scene import PartitionedScene as PartitionedScene
from wrt.disk.partitioned_scene import QueryTraffic as QueryTraffic

__all__ = [
    "PartitionedHits",
    "PartitionedScene",
    "QueryTraffic",
]
