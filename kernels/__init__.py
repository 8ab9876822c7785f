"""The code that runs per ray and per triangle: Warp kernels over structure-of-arrays buffers, for CPUs and CUDA.

The CPU target is chosen before the first kernel is defined: by `wrt.kernels.runtime.options`, which all files with kernels
import.
This package itself imports nothing, so that checks of arguments (`wrt.kernels.validation`) do not load Warp.
"""
