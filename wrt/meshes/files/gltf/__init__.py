"""glTF 2.0, as .gltf and .glb.

`document` (JSON, buffers, accessors), `primitives`, `nodes`, `gltf_materials`; `gltf_file` joins them.

References: khronos-gltf-2022.
"""
