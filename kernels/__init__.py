"""The code that runs per ray and per triangle: Warp kernels over structure-of-arrays buffers, for CPUs and CUDA.

Importing this package chooses the CPU target before the first kernel is defined (`wrt.kernels.compilation.target`).
"""

from wrt.kernels.compilation import target

target.apply_environment()
