"""Image files."""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np

from wrt.kernels.validation import host_array

__all__ = ["check_path", "save_exr", "save_image", "to_bytes"]

_WITHOUT_ALPHA = (".jpg", ".jpeg", ".jpe", ".jfif", ".bmp", ".ppm")


def save_image(path: str | Path, image: Any) -> None:
    """Writes an image in the format given by the file's extension.

    Args:
        path: ".png", ".jpg" or any other extension that Pillow writes; ".npy" for the array as it is; ".exr" for floats as they
            are, 32 bits each, which should be linear (`wrt.Rendering.linear`): this needs the package OpenEXR (`wrt[exr]`).
        image: (H, W) grey, (H, W, 3) RGB or (H, W, 4) RGBA; uint8, or floats for display (sRGB, as returned by
            `wrt.render`) in [0, 1], which are clipped and rounded to 8 bits. Integers and booleans, such as ids, can only
            be saved as ".npy".

    Raises:
        TypeError: neither uint8 nor floats.
        ValueError: wrong shape, NaN or infinity, an unknown extension, or alpha in a format that has none.
        FileNotFoundError: the folder does not exist.
    """
    path = check_path(path)
    suffix = path.suffix.lower()
    array = _checked(image, any_number=suffix == ".npy")
    if suffix == ".npy":
        with open(path, "wb") as file:  # given a path, NumPy would add the extension to one in capitals
            np.save(file, array)
        return
    if suffix == ".exr":
        channels = {1: "Y", 3: "RGB", 4: "RGBA"}[1 if array.ndim == 2 else array.shape[2]]
        pixels = (array.astype(np.float32) / (255 if array.dtype == np.uint8 else 1)).astype(np.float32)
        save_exr(path, {name: pixels.reshape(*array.shape[:2], -1)[..., i] for i, name in enumerate(channels)})
        return
    from PIL import Image

    if suffix in _WITHOUT_ALPHA and array.ndim == 3 and array.shape[2] == 4:
        raise ValueError(f"'{suffix}' has no alpha channel; save image[..., :3] or use .png")
    options = {"quality": 95, "subsampling": 0} if suffix in (".jpg", ".jpeg") else {}
    try:
        Image.fromarray(to_bytes(array)).save(path, **options)
    except (KeyError, ValueError) as error:  # a Pillow format that does not support this kind of image
        raise ValueError(f"cannot write '{path}' ({error}); use .png") from error


def save_exr(path: str | Path, channels: dict[str, np.ndarray]) -> None:
    """Writes an OpenEXR file, compressed without loss.

    Args:
        path: of the file.
        channels: (H, W) float32 or uint32 by name, such as "R" or "normal.X".

    Raises:
        ValueError: the package OpenEXR is missing.
        FileNotFoundError: the folder does not exist.
    """
    path = check_path(path)
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    with OpenEXR.File(header, {name: np.ascontiguousarray(values) for name, values in channels.items()}) as file:
        file.write(str(path))


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
