"""Scenes larger than memory: parts on disk, each with its tree, loaded on demand while rays wait for them.

    scene = wrt.disk.PartitionedScene.build(paths_of_tiles, "city", memory="2 GB")
    hits = scene.intersect(origins, directions)     # `PartitionedHits`
    scene.last_query                                # `QueryTraffic`: what was read

Hits are those of one `wrt.Scene` with the same meshes.
"""

from __future__ import annotations

from wrt.lazy_names import lazy_names

_HOME = {
    "PartitionedHits": "wrt.disk.partitioned_hits",
    "PartitionedScene": "wrt.disk.partitioned_scene",
    "QueryTraffic": "wrt.disk.partitioned_scene",
}

__all__ = [*_HOME]

__getattr__, __dir__ = lazy_names(__name__, _HOME)
