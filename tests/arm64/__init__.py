"""Hits, trees and pictures on an emulated ARM processor (aarch64) have the bits of x86.

`python -m tests.arm64` puts Debian's Python for arm64 and the wheels of wrt's dependencies into a folder, and runs
`emulated.py` there by `qemu-user`: a pool of four threads, closest hits and occlusion by every traversal, trees of every
builder, pictures, closest points, a scan. Their hashes are those of `tests/bits` for 8 lanes, or are computed here first.

Emulated, Warp's compiler needs half a minute for a module. So modules are compiled by Clang of the `ziglang` wheel, which the
emulated process starts and which runs on this CPU; but Warp's own compiles those named in `cross_compiler.BY_WARP`. What this
shows is thus: that the code of ARM gives the bits of x86, and that threads, memory and files work there. What it does not
show: speed, and the code that Warp's compiler makes of the other modules.

Needs root and `apt-get` with packages for arm64 (Debian's mirrors have them); elsewhere it says so and ends with status 0.
"""
