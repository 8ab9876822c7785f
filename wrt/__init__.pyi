# Written by `python -m tests.typed.stubs` from the table of names in wrt/__init__.py.
from wrt import analysis as analysis
from wrt import batches as batches
from wrt import classics as classics
from wrt import cluster as cluster
from wrt import compat as compat
from wrt import device as device
from wrt import disk as disk
from wrt import known_rays as known_rays
from wrt import lights as lights
from wrt import moving as moving
from wrt import pictures as pictures
from wrt import results as results
from wrt import scenes as scenes
from wrt import sensors as sensors
from wrt.accelerators.tree_descriptions import Bvh as Bvh
from wrt.accelerators.tree_descriptions import KdTree as KdTree
from wrt.engine.rays.rays import Rays as Rays
from wrt.imaging.cameras import OrthographicCamera as OrthographicCamera
from wrt.imaging.cameras import PinholeCamera as PinholeCamera
from wrt.imaging.image_files import save_image as save_image
from wrt.imaging.integrators.rendering_call import render as render
from wrt.kernels.runtime.launch import get_num_threads as get_num_threads
from wrt.kernels.runtime.launch import set_num_threads as set_num_threads
from wrt.materials.material import Material as Material
from wrt.materials.material import Texture as Texture
from wrt.meshes.instance import Instance as Instance
from wrt.meshes.mesh import TriangleMesh as TriangleMesh
from wrt.query.all_hits import AllHits as AllHits
from wrt.query.hits import Hits as Hits
from wrt.scene.scene import Scene as Scene
from wrt.viewer.live_view import view as view

__version__: str

__all__ = [
    "AllHits",
    "Bvh",
    "Hits",
    "Instance",
    "KdTree",
    "Material",
    "OrthographicCamera",
    "PinholeCamera",
    "Rays",
    "Scene",
    "Texture",
    "TriangleMesh",
    "__version__",
    "analysis",
    "batches",
    "cluster",
    "compat",
    "device",
    "disk",
    "get_num_threads",
    "known_rays",
    "lights",
    "moving",
    "pictures",
    "render",
    "results",
    "save_image",
    "scenes",
    "sensors",
    "set_num_threads",
    "view",
]
