"""What runs per ray and per triangle: Warp kernels over structure-of-arrays buffers, for CPUs and CUDA.

The CPU to compile for is settled before the first kernel is defined (`wrt.kernels.runtime.target`).
"""

from wrt.kernels.runtime import target

target.apply_environment()
