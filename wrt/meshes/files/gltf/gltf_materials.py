"""Materials of glTF: base colour, metallic share, roughness, emission, and the images of the first three.

Read too: how images go on beyond their edges (samplers), and `KHR_texture_transform`, which becomes part of the texture
coordinates. A mesh has one set of texture coordinates here: an image that uses another set or another transform than that of
the base colour is left out with a warning. Of alpha, the mode MASK is read
(`Material.alpha_cutoff`); that of vertices is a factor of it (`wrt.meshes.files.gltf.primitives`). Normal maps, occlusion,
images of emission, the mode BLEND and filters are not read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from wrt.materials.material import Material, Texture, cutoff_of_image
from wrt.meshes.files.file_images import FileImages
from wrt.meshes.files.gltf.document import Document

__all__ = ["GltfMaterials", "UsedMaterial"]

WRAPS = {10497: "repeat", 33071: "clamp", 33648: "mirror"}


@dataclass(frozen=True)
class Placement:
    """Where an image lies: the set of texture coordinates, and their map by `KHR_texture_transform`."""

    texcoord: int = 0
    offset: tuple[float, float] = (0.0, 0.0)
    rotation: float = 0.0
    scale: tuple[float, float] = (1.0, 1.0)

    def __call__(self, uv: np.ndarray) -> np.ndarray:
        """(..., 2) coordinates: scaled, turned, moved.

        They turn from u to -v, which is counter-clockwise on the image, as in the extension's words and sample model; the
        matrix that its text prints turns the other way.
        """
        if (self.offset, self.rotation, self.scale) == ((0.0, 0.0), 0.0, (1.0, 1.0)):
            return uv
        u, v = uv[..., 0] * self.scale[0], uv[..., 1] * self.scale[1]
        cos, sin = np.cos(self.rotation), np.sin(self.rotation)
        return np.stack([cos * u + sin * v + self.offset[0], cos * v - sin * u + self.offset[1]], axis=-1)


@dataclass(frozen=True)
class UsedMaterial:
    """A material of the file.

    Attributes:
        name: for messages.
        plain: without images; None if a primitive has no material.
        textured: makes it with its images; None if it has none.
        placement: of its images.
        has_images: whether it refers to images that could be read.
    """

    name: str
    plain: Material | None
    textured: Callable[[], Material] | None
    placement: Placement

    @property
    def texcoord(self) -> int:
        """The set of texture coordinates."""
        return self.placement.texcoord

    @property
    def has_images(self) -> bool:
        """Whether it has images that are read."""
        return self.textured is not None

    def transform(self, uv: np.ndarray) -> np.ndarray:
        """Texture coordinates of its images."""
        return self.placement(uv)


class GltfMaterials:
    """The materials of a file, each made once."""

    def __init__(self, document: Document) -> None:
        self._document, self._source = document, document.source
        self._images = FileImages(document.source)
        self._known: dict[Any, UsedMaterial] = {}

    def of(self, index: Any) -> UsedMaterial:
        """The material of that number; one without values for None."""
        if index is None:
            return UsedMaterial("", None, None, Placement())
        item = self._document.item("materials", index)
        if index not in self._known:
            self._known[index] = self._made(item, index)
        return self._known[index]

    def _made(self, item: dict[str, Any], index: int) -> UsedMaterial:
        name = f"'{item['name']}'" if isinstance(item.get("name"), str) else f"number {index}"
        model = item.get("pbrMetallicRoughness") or {}
        base, surface = model.get("baseColorTexture"), model.get("metallicRoughnessTexture")
        values: dict[str, Any] = {
            "color": (base_color := self._numbers(model, "baseColorFactor", (1.0, 1.0, 1.0, 1.0), name))[:3],
            "metallic": self._number(model, "metallicFactor", name),
            "roughness": self._number(model, "roughnessFactor", name),
            "emission": self._emission(item, name),
        }
        gloss = (item.get("extensions") or {}).get("KHR_materials_pbrSpecularGlossiness")
        if gloss is not None and "pbrMetallicRoughness" not in item:
            base_color = self._numbers(gloss, "diffuseFactor", (1.0, 1.0, 1.0, 1.0), name)
            values["color"] = base_color[:3]
            values["metallic"], values["roughness"] = 0.0, 1.0 - self._number(gloss, "glossinessFactor", name)
            base, surface = gloss.get("diffuseTexture"), None
        if item.get("alphaMode") == "MASK":
            given = {"alphaCutoff": [item.get("alphaCutoff", 0.5)]}
            cutoff = self._numbers(given, "alphaCutoff", (0.5,), name, maximum=1e30)[0]
            values["alpha_cutoff"] = cutoff_of_image(cutoff, base_color[3])
        plain = Material("glossy", **values)
        places = [self._placement(one, name) for one in (base, surface) if one is not None]
        if len(places) == 2 and places[0] != places[1]:
            self._source.warn(
                f"the image of roughness of material {name} has other coordinates than that of its colour; it is left out"
            )
            surface = None
        if not places:
            return UsedMaterial(name, plain, None, Placement())

        made: list[Material] = []

        def textured() -> Material:
            if not made:
                color, rest = self._texture(base, name), self._texture(surface, name)
                made.append(Material("glossy", **values, color_texture=color, surface_texture=rest))
            return made[0]

        return UsedMaterial(name, plain, textured, places[0])

    def _emission(self, item: dict[str, Any], name: str) -> tuple[float, ...]:
        factor = self._numbers(item, "emissiveFactor", (0.0, 0.0, 0.0), name, maximum=1e30)
        if item.get("emissiveTexture") is not None:
            if any(factor):
                self._source.warn(f"the image of the light that material {name} emits is not read; it emits none")
            return (0.0, 0.0, 0.0)
        strength = (item.get("extensions") or {}).get("KHR_materials_emissive_strength") or {}
        scale = strength.get("emissiveStrength", 1.0)
        scale = self._numbers({"strength": [scale]}, "strength", (1.0,), name, maximum=1e30)[0]
        return tuple(scale * value for value in factor)

    def _number(self, item: dict[str, Any], key: str, name: str) -> float:
        return self._numbers({key: [item[key]]} if key in item else {}, key, (1.0,), name)[0]

    def _numbers(
        self, item: dict[str, Any], key: str, default: tuple[float, ...], name: str, maximum: float = 1.0
    ) -> tuple[float, ...]:
        """Numbers from 0 to `maximum`; the default, with a warning, if they are none."""
        given = item.get(key)
        if given is None:
            return default
        try:
            array = np.array(given, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.array(np.nan)
        if array.shape != (len(default),) or not np.isfinite(array).all():
            self._source.warn(
                f"the {key} of material {name} is {str(given)[:60]}, not {len(default)} finite numbers; it is plain"
            )
            return default
        return tuple(np.clip(array, 0.0, maximum).tolist())

    def _placement(self, info: dict[str, Any], name: str) -> Placement:
        """Where the image of a `textureInfo` lies."""
        texcoord, moved = info.get("texCoord", 0), (info.get("extensions") or {}).get("KHR_texture_transform") or {}
        texcoord = moved.get("texCoord", texcoord)
        if isinstance(texcoord, bool) or not isinstance(texcoord, int):
            raise ValueError(f"the texCoord of material {name} is {texcoord!r}")
        values: dict[str, Any] = {}
        for key, default in (("offset", [0.0, 0.0]), ("rotation", 0.0), ("scale", [1.0, 1.0])):
            try:
                value = np.array(moved.get(key, default), dtype=np.float64)
            except (TypeError, ValueError):
                value = np.array(np.nan)
            if value.shape != np.shape(default) or not np.isfinite(value).all():
                raise ValueError(f"the KHR_texture_transform of material {name} has {key} = {str(moved[key])[:60]}")
            values[key] = tuple(value.tolist()) if value.shape else float(value)
        return Placement(texcoord, **values)

    def _texture(self, info: dict[str, Any] | None, name: str) -> Texture | None:
        """The image of a `textureInfo`; None, with a warning, if it cannot be read."""
        if info is None:
            return None
        texture = self._document.item("textures", info.get("index"))
        sampler = {} if texture.get("sampler") is None else self._document.item("samplers", texture["sampler"])
        wraps = [WRAPS.get(sampler.get(key, 10497)) for key in ("wrapS", "wrapT")]
        if None in wraps:
            raise ValueError(
                f"a sampler of material {name} has wrapS, wrapT = {sampler.get('wrapS')!r}, {sampler.get('wrapT')!r}"
            )
        number = ((texture.get("extensions") or {}).get("EXT_texture_webp") or texture).get("source")
        if number is None:
            self._source.warn(f"the image of material {name} is in a form that is not read; the surface is plain")
            return None
        image, what = self._document.item("images", number), f"material {name}"
        uri = image.get("uri")
        if isinstance(uri, str) and not uri.startswith("data:"):
            from urllib.parse import unquote

            return self._images.of_file(unquote(uri), what, tuple(wraps))  # type: ignore[arg-type]
        return self._images.of_bytes(number, lambda: self._image_bytes(image, uri, number), what, tuple(wraps))  # type: ignore[arg-type]

    def _image_bytes(self, image: dict[str, Any], uri: Any, number: int) -> bytes:
        if uri is not None:
            return self._document.of_uri(uri, f"images[{number}]")
        data, begin, length, _ = self._document.view(image.get("bufferView"))
        return data[begin : begin + length]
