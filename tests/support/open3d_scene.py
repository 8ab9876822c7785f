"""The same triangles for wrt's form of Open3D's scene and for Open3D."""

from __future__ import annotations

import numpy as np
import trimesh

SPHERE = trimesh.creation.icosphere(subdivisions=2)

TORUS = trimesh.creation.torus(1.0, 0.4)

PARTS = [(mesh.vertices.astype(np.float32), mesh.faces.astype(np.uint32)) for mesh in (SPHERE, TORUS)]
