"""Names of devices, as each library writes them."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

import wrt
from wrt.kernels.runtime.launch import as_device

MESH = wrt.scenes.build("teapot", level=2)


class Device:
    """A device of another library: its text is its name."""

    def __init__(self, name: str) -> None:
        self.name = name

    def __str__(self) -> str:
        return self.name


@pytest.mark.parametrize(
    "name", ["cpu", "CPU", "Cpu:0", "CPU:0", "cpu:00", " cpu ", Device("CPU:0"), wp.get_device("cpu")], ids=str
)
def test_the_cpu_by_any_name(name):
    """Open3D's "CPU:0" was accepted by its stand-in, whose first query then failed."""
    assert as_device(name) is wp.get_device("cpu")
    assert wrt.Scene(MESH, device=name).device.is_cpu
    assert wrt.compat.RaycastingScene(device=name).cast_rays(np.ones((2, 6))) is not None
    assert wrt.compat.RayMeshIntersector(MESH, device=name).scene.device.is_cpu


@pytest.mark.parametrize(
    "name", ["cpu:1", "CUDA:97", "cuda:97", "GPU:97", "", "cpu0", "opengl", "cuda:-1", "cpu:0:0", Device("xpu:0"), 0, 1.5]
)
def test_devices_that_are_not_there(name):
    """The constructor says so, with the names of those that are."""
    for make in (
        lambda: wrt.Scene(MESH, device=name),
        lambda: wrt.compat.RaycastingScene(device=name),
        lambda: wrt.compat.RayMeshIntersector(MESH, device=name),
        lambda: wrt.moving.FuzzyScene(MESH.vertices[None], MESH.faces, device=name),
    ):
        with pytest.raises((TypeError, ValueError), match=r"device .*does not exist.*cpu"):
            make()


def test_a_gpu_by_any_name():
    if not wp.is_cuda_available():
        pytest.skip("needs CUDA")
    for name in ("cuda", "CUDA", "cuda:0", "CUDA:0", "gpu:0", Device("cuda:0")):
        assert as_device(name).is_cuda
