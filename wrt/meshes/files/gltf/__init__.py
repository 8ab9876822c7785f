"""glTF 2.0, as .gltf and .glb.

`document` (JSON, buffers, accessors), `primitives`, `nodes`, `gltf_materials`; `gltf_file` joins them.

References:
    Khronos 3D Formats Working Group: glTF 2.0 specification. ISO/IEC 12113:2022.
"""
