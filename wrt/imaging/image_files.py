"""Image files, written beside the old ones, which they replace when they are complete (`wrt.atomic_files`)."""

from __future__ import annotations

import io
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from wrt.atomic_files import replaced
from wrt.kernels.validation import host_array

if TYPE_CHECKING:
    from wrt.array_types import ArrayLike

__all__ = ["check_path", "save_exr", "save_image", "to_bytes"]

_WITHOUT_ALPHA = (".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".ppm")

OPTIONS: dict[str, dict[str, Any]] = {
    ".jpg": {"quality": 95, "subsampling": 0},
    ".jpeg": {"quality": 95, "subsampling": 0},
    ".j2k": {"no_jp2": True},
}
"""Options of Pillow's by extension."""


def save_image(path: str | Path, image: ArrayLike) -> None:
    """Writes an image in the format given by the file's extension.

    Args:
        path: ".png", ".jpg" or any other extension that Pillow writes; ".npy" for the array as it is; ".exr" for floats as they
            are, 32 bits each, which should be linear (`wrt.pictures.Rendering.linear`): this needs the package OpenEXR
            (`wrt[exr]`).
        image: (H, W) grey, (H, W, 3) RGB or (H, W, 4) RGBA; uint8, or floats for display (sRGB, as returned by
            `wrt.render`) in [0, 1], which are clipped and rounded to 8 bits. Integers and booleans, such as ids, can only
            be saved as ".npy".

    Raises:
        TypeError: neither uint8 nor floats.
        ValueError: wrong shape, NaN or infinity, an unknown extension, or alpha in a format that has none.
        FileNotFoundError: the folder does not exist.
        OSError: the file cannot be written. An older one is as it was.
    """
    path = check_path(path)
    suffix = path.suffix.lower()
    array = _checked(image, any_number=suffix == ".npy")
    if suffix == ".npy":
        with replaced(path, streams=True) as file:
            np.save(file, array)
        return
    if suffix == ".exr":
        channels = {1: "Y", 3: "RGB", 4: "RGBA"}[1 if array.ndim == 2 else array.shape[2]]
        with np.errstate(over="ignore"):
            pixels = (array.astype(np.float32) / (255 if array.dtype == np.uint8 else 1)).astype(np.float32)
        if not np.isfinite(pixels).all():
            raise ValueError("image has values beyond the range of float32, which .exr files hold; save it as .npy")
        save_exr(path, {name: pixels.reshape(*array.shape[:2], -1)[..., i] for i, name in enumerate(channels)})
        return
    from PIL import Image

    if suffix in _WITHOUT_ALPHA and array.ndim == 3 and array.shape[2] == 4:
        raise ValueError(f"'{suffix}' has no alpha channel; save image[..., :3] or use .png")
    content, file_format = io.BytesIO(), Image.registered_extensions()[suffix]
    try:
        Image.fromarray(to_bytes(array)).save(content, file_format, **OPTIONS.get(suffix, {}))
    except (KeyError, ValueError, OSError) as error:  # a Pillow format that does not support this kind of image
        raise ValueError(f"cannot write '{path}' ({error}); use .png") from error
    with replaced(path, streams=True) as file:
        file.write(content.getbuffer())


def save_exr(path: str | Path, channels: dict[str, np.ndarray]) -> None:
    """Writes an OpenEXR file, compressed without loss.

    Args:
        path: of the file.
        channels: (H, W) float32 or uint32 by name, such as "R" or "normal.X".

    Raises:
        ValueError: the package OpenEXR is missing.
        FileNotFoundError: the folder does not exist.
        OSError: the file cannot be written. An older one is as it was.
    """
    path = check_path(path)
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    arrays = {name: np.ascontiguousarray(values) for name, values in channels.items()}
    with replaced(path, streams=True) as file, OpenEXR.File(header, arrays) as picture:
        try:
            picture.write(file.name)
        except RuntimeError as error:
            raise OSError(str(error)) from error


def check_path(path: str | Path) -> Path:
    """Returns the path if an image can be written there; errors as in `save_image`."""
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix == ".exr":
        if find_spec("OpenEXR") is None:
            raise ValueError(f"cannot write '{path}': the package OpenEXR is missing; install it with pip install 'wrt[exr]'")
    elif suffix != ".npy":
        from PIL import Image

        if suffix not in {extension for extension, name in Image.registered_extensions().items() if name in Image.SAVE}:
            raise ValueError(f"cannot write '{path}': unknown extension '{suffix}'; use .png, .jpg, .npy or another")
    if not path.parent.is_dir():
        raise FileNotFoundError(f"there is no folder '{path.parent}' to write '{path.name}' to; create it first")
    return path


def to_bytes(image: np.ndarray) -> np.ndarray:
    """(...) uint8 of display floats in [0, 1], rounded to the nearest; uint8 unchanged."""
    if image.dtype == np.uint8:
        return image
    return np.rint(np.clip(image, 0.0, 1.0) * 255.0).astype(np.uint8)


def _checked(image: Any, any_number: bool) -> np.ndarray:
    array = host_array("image", image)
    if array.dtype != np.uint8 and array.dtype.kind not in ("fiub" if any_number else "f"):
        remedies = {
            "b": "multiply by np.uint8(255)",
            "i": "ids are not brightness: give each a colour, for example np.random.default_rng(0).random((n, 3))[ids], or "
            "save the numbers in a .npy file",
        }
        remedy = remedies.get(array.dtype.kind.replace("u", "i"), "convert it first")
        raise TypeError(f"image must be uint8, or floats in [0, 1], not {array.dtype}; {remedy}")
    if not (array.ndim == 2 or (array.ndim == 3 and array.shape[2] in (3, 4))) or array.size == 0:
        raise ValueError(f"image must have shape (H, W), (H, W, 3) or (H, W, 4), not {array.shape}")
    if array.dtype.kind == "f" and not np.isfinite(array).all():
        count = int((~np.isfinite(array)).sum())
        raise ValueError(f"image has {count} values that are NaN or infinite; replace them, for example with np.nan_to_num")
    return array
