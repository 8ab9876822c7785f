"""Images that meshes refer to: read once, with a limit on their size; one that cannot be read is a warning."""

from __future__ import annotations

import io
import warnings

import numpy as np

from wrt.materials.material import Texture, has_alpha
from wrt.meshes.files.mesh_source import MeshSource

__all__ = ["MAX_PIXELS", "FileImages"]

MAX_PIXELS = 1 << 27
"""Pixels of an image, 400 MB: one of 11,585 x 11,585."""

Wrap = tuple[str, str]


class FileImages:
    """The images of a mesh's materials. Equal references give one `Texture`."""

    def __init__(self, source: MeshSource) -> None:
        self._source = source
        self._pixels: dict[object, np.ndarray | None] = {}
        self._textures: dict[tuple[object, Wrap], Texture] = {}

    def of_file(self, name: str, material: str, wrap: Wrap = ("repeat", "repeat")) -> Texture | None:
        """The image in a file that the mesh refers to; None, with a warning, if there is none or it is no image.

        Raises:
            ValueError: it may not be read, or is too large.
        """

        def read() -> bytes | None:
            try:
                return self._source.referenced(name, f"the image of {material}")
            except FileNotFoundError:
                self._source.warn(f"there is no file '{name}', the image of {material}; the surface is plain")
                return None

        return self._texture(name, read, f"the image '{name}' of {material}", wrap)

    def of_bytes(self, key: object, read, material: str, wrap: Wrap = ("repeat", "repeat")) -> Texture | None:
        """An image inside the mesh's file.

        Args:
            key: what identifies it.
            read: returns its bytes.
            material: to name in messages.
            wrap: of the texture.
        """
        return self._texture(key, read, f"the image of {material}", wrap)

    def _texture(self, key: object, read, what: str, wrap: Wrap) -> Texture | None:
        if key not in self._pixels:
            data = read()
            self._pixels[key] = None if data is None else self._decoded(data, what)
        pixels = self._pixels[key]
        if pixels is None:
            return None
        if (key, wrap) not in self._textures:
            self._textures[key, wrap] = Texture(pixels, wrap=wrap)
        return self._textures[key, wrap]

    def _decoded(self, data: bytes, what: str) -> np.ndarray | None:
        """(H, W, 3) uint8, or (H, W, 4) with alpha."""
        from PIL import Image

        size = "more pixels than can be read"
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the limit below stands in its place
                image = Image.open(io.BytesIO(data))
            with image:
                if image.width * image.height <= MAX_PIXELS:
                    return np.array(image.convert("RGBA" if has_alpha(image) else "RGB"))
                size = f"{image.width} x {image.height} pixels"
        except Image.DecompressionBombError:
            pass
        except Exception as error:  # decoders of thirty formats raise many types of error
            self._source.warn(f"{what} cannot be read ({type(error).__name__}: {error}); the surface is plain")
            return None
        raise ValueError(
            f"{what} has {size}, and those of more than {MAX_PIXELS:,} are not read; make it smaller, or load the mesh with "
            "materials=False and map the image from a file: wrt.Texture(np.load(..., mmap_mode='r'))"
        )
