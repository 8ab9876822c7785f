"""What runs per ray and per triangle: Warp kernels over structure-of-arrays buffers, for CPUs and CUDA.

The CPU to compile for is settled before the first kernel is defined (`wrt.kernels.target`).
"""

from wrt.kernels import target

target.apply_environment()
