"""How a surface scatters and emits light."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from wrt.kernels.validation import as_float, as_numbers, convert_fields, host_array
from wrt.tables import one_of

if TYPE_CHECKING:
    import PIL.Image

    from wrt.array_types import ArrayLike

__all__ = ["KINDS", "Material", "Texture"]

KINDS = ("diffuse", "mirror", "dielectric", "glossy")
"""In the order of their numbers in `wrt.kernels.shading.bsdf.material_table`."""

WRAPS = ("repeat", "clamp", "mirror")
"""How images go on beyond their edges, in the order of their numbers there."""

NOWHERE = 2.0
"""An alpha that no pixel has."""

Color = tuple[float, float, float]


class Texture:
    """An image that varies a material over a surface, interpolated bilinearly.

    Args:
        image: (H, W), (H, W, 3) or (H, W, 4), uint8 or floats in [0, 1]; or an image of Pillow. Row 0 is at the top, where v
            is 1. Stored with 8 bits a channel.
        wrap: how it goes on outside [0, 1]: "repeat", "clamp" (its edge) or "mirror" (repeated, every other time mirrored); one
            for both directions, or a pair for u and v.

    Attributes:
        pixels: (H, W, 3) uint8.
        alpha: (H, W) uint8, which `Material.alpha_cutoff` cuts; None for an image without, or that is opaque.
        wrap: (2,) str, of u and of v.

    Raises:
        TypeError: not an image.
        ValueError: a wrong shape, values that are not in [0, 1], or an unknown `wrap`.
    """

    def __init__(self, image: ArrayLike | PIL.Image.Image, *, wrap: str | tuple[str, str] = "repeat") -> None:
        self.wrap = _wrap(wrap)
        if hasattr(image, "convert"):
            image = image.convert("RGBA" if has_alpha(image) else "RGB")
        array = host_array("image", image)
        if array.dtype.kind not in "fu" or (array.dtype.kind == "u" and array.dtype != np.uint8):
            raise TypeError(f"image must hold uint8, or floats in [0, 1], not {array.dtype}")
        if array.ndim == 2:
            array = np.repeat(array[..., None], 3, axis=2)
        if array.ndim != 3 or array.shape[2] not in (3, 4) or array.size == 0:
            raise ValueError(f"image must have shape (H, W), (H, W, 3) or (H, W, 4), not {array.shape}")
        if array.dtype.kind == "f":
            if not (np.isfinite(array).all() and array.min() >= 0.0 and array.max() <= 1.0):
                raise ValueError(f"image must be in [0, 1], but ranges from {array.min()} to {array.max()}")
            array = np.rint(array * 255.0)
        self.pixels = np.ascontiguousarray(array[..., :3], dtype=np.uint8)
        alpha = array[..., 3].astype(np.uint8) if array.shape[2] == 4 else np.array(255)
        self.alpha = None if alpha.min() == 255 else alpha
        self.pixels.flags.writeable = False

    def __repr__(self) -> str:
        wrap = "" if self.wrap == ("repeat", "repeat") else f", wrap={self.wrap}"
        return f"Texture({self.pixels.shape[1]} x {self.pixels.shape[0]}{wrap})"

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Pickles of earlier versions have neither `wrap` nor `alpha`."""
        self.__dict__.update({"wrap": ("repeat", "repeat"), "alpha": None} | state)


@dataclass(frozen=True)
class Material:
    """How a surface scatters and emits light. All colours are linear.

        wall = wrt.Material(color=(0.7, 0.6, 0.5))
        glass = wrt.Material("dielectric", index=1.5, absorption=(0.8, 0.1, 0.3))
        gold = wrt.Material("glossy", color=(1.0, 0.77, 0.34), metallic=1.0, roughness=0.3)
        lamp = wrt.Material(color=0.0, emission=10.0)

    Kinds:

    * "diffuse": Lambert's cosine law. The share `translucency` of the light leaves on the other side.
    * "mirror": reflects `color` to one direction.
    * "dielectric": glass, water. Reflects by Fresnel's equations, refracts by Snell's law, absorbs by Beer's law. Surfaces
      must be closed, with normals that point outward. With a `roughness`, light is spread by facets (GGX): frosted glass.
    * "glossy": facets (GGX, with Smith's shadowing and masking) over a diffuse base, as in glTF.

    Args:
        kind: one of these.
        color: share of light that is scattered, in [0, 1]: a number or (3,). Of dielectrics, the share at each crossing.
        roughness: in [0, 1]; the square is the width of the GGX distribution. None: 0.5 for "glossy", 0 for "dielectric".
        metallic: of "glossy", in [0, 1]: 0 reflects white over a diffuse base, 1 reflects `color` and has no base.
        index: of refraction, above 0; of "glossy" too, whose reflection at normal incidence follows from it.
        absorption: of "dielectric", per unit of length: a number or (3,), each >= 0.
        priority: of "dielectric": where bodies overlap, the higher one is there (Schmidt and Budge 2002).
        translucency: of "diffuse", in [0, 1].
        emission: radiance that the surface emits: a number or (3,), each >= 0.
        two_sided: whether the back emits, too.
        color_texture: multiplied with `color`; its values are sRGB. Needs texture coordinates.
        alpha_cutoff: of leaves and lattices: least alpha of `color_texture`, from 0 to 1, where a surface is, in scenes that
            ask for it (`wrt.Scene.filtered`); above 1 there is none. None: alpha is ignored. Is glTF's mode MASK.
        surface_texture: its green multiplies the roughness, its blue the metallic share, both linear.

    Raises:
        TypeError: a texture or priority of a wrong type.
        ValueError: a value out of range, or an unknown kind.
    """

    kind: str = "diffuse"
    color: Any = 0.8
    roughness: float | None = None
    metallic: float = 0.0
    index: float = 1.5
    absorption: Any = 0.0
    priority: int = 0
    translucency: float = 0.0
    emission: Any = 0.0
    two_sided: bool = True
    color_texture: Texture | None = None
    surface_texture: Texture | None = None
    alpha_cutoff: float | None = None

    def __post_init__(self) -> None:
        one_of(KINDS, self.kind, "kind")
        convert_fields(self)
        kept: dict[str, Any] = {
            "color": as_color("color", self.color, 1.0),
            "absorption": as_color("absorption", self.absorption),
            "emission": as_color("emission", self.emission),
            "roughness": _share("roughness", {"glossy": 0.5}.get(self.kind, 0.0) if self.roughness is None else self.roughness),
            "metallic": _share("metallic", self.metallic),
            "translucency": _share("translucency", self.translucency),
        }
        if self.alpha_cutoff is not None:
            kept["alpha_cutoff"] = as_float("alpha_cutoff", self.alpha_cutoff, finite=True)
            if kept["alpha_cutoff"] < 0.0:
                raise ValueError(f"alpha_cutoff is {self.alpha_cutoff!r}; it must be 0 or more, or None to ignore alpha")
        if not 0.0 < self.index < np.inf:
            raise ValueError(f"index is {self.index!r}; an index of refraction is a number above 0, such as 1.5 for glass")
        for name in ("color_texture", "surface_texture"):
            if not isinstance(getattr(self, name), Texture | None):
                raise TypeError(f"{name} must be a wrt.Texture or None, not {type(getattr(self, name)).__name__}")
        for name, value in kept.items():
            object.__setattr__(self, name, value)

    @property
    def emits(self) -> bool:
        """Whether the surface emits light."""
        return any(self.emission)


def has_alpha(image: Any) -> bool:
    """Whether an image of Pillow has transparent pixels, or may have."""
    return "A" in image.getbands() or "transparency" in image.info


def cutoff_of_image(cutoff: float, factor: float) -> float:
    """The cutoff for an image's own alpha, of one for alpha times a factor from 0 to 1, as in glTF."""
    if cutoff <= 0.0:
        return 0.0
    return cutoff / factor if cutoff <= factor else NOWHERE


Materials: TypeAlias = "Material | Iterable[Material]"
"""One for all, or one for each mesh."""


def as_color(name: str, value: Any, maximum: float = np.inf) -> Color:
    """Three finite numbers from 0 to `maximum`; a number becomes a grey.

    Raises:
        TypeError: not real numbers.
        ValueError: other numbers, or another shape.
    """
    color = as_numbers(name, value, finite=False)
    if color.shape not in ((), (3,)) or not (np.isfinite(color).all() and (color >= 0.0).all() and (color <= maximum).all()):
        limit = f"from 0 to {maximum:g}" if np.isfinite(maximum) else "finite and not negative"
        raise ValueError(f"{name} must be a number or three numbers (red, green, blue), {limit}, not {value!r}")
    return tuple(np.broadcast_to(color, 3).tolist())


def _wrap(wrap: Any) -> tuple[str, str]:
    pair = (wrap, wrap) if isinstance(wrap, str) else tuple(wrap) if isinstance(wrap, tuple | list) else (wrap,)
    if len(pair) != 2 or not all(isinstance(one, str) and one in WRAPS for one in pair):
        raise ValueError(f"wrap must be one of {', '.join(map(repr, WRAPS))}, or a pair of them for u and v, not {wrap!r}")
    return pair


def _share(name: str, value: float) -> float:
    if not 0.0 <= value <= 1.0:
        raise ValueError(f"{name} is {value!r}; it must be from 0 to 1")
    return value


def check_materials(materials: Any, count: int, what: str) -> tuple[Material, ...]:
    """So many materials, from one for all or from a sequence.

    Raises:
        TypeError: something else.
        ValueError: another number.
    """
    if isinstance(materials, Material):
        return (materials,) * count
    materials = tuple(materials) if isinstance(materials, Iterable) else (None,)
    if not all(isinstance(one, Material) for one in materials):
        raise TypeError(f"materials must be a wrt.Material or a sequence of them, not {materials!r}")
    if len(materials) != count:
        raise ValueError(
            f"materials has {len(materials)} entries, but there are {count} {what}; pass one for each, or one for all"
        )
    return materials
