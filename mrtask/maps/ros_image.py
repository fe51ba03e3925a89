"""Read the image of a ROS map, and find which cells are surely free, as map_server does.

Source: nav2's map_server, modes ``trinary`` and ``scale``. A cell's lightness is the mean of its colour channels,
scaled by the largest value of the image's type; a cell that is not opaque is unknown.
"""

import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from mrtask.arrays import Bools, Floats
from mrtask.maps.home_map import MAX_CELLS

UNKNOWN_LIGHTNESS = 205 / 255
"""The grey that map_saver writes for cells that no robot has seen."""
_DIRECT = {"L": 255.0, "LA": 255.0, "RGB": 255.0, "RGBA": 255.0, "I;16": 65535.0, "I;16B": 65535.0, "I;16L": 65535.0}
"""The modes of Pillow whose numbers are read unchanged, with their largest value."""
_CONVERTED = {"1": "L", "P": "RGBA", "PA": "RGBA", "CMYK": "RGB", "YCbCr": "RGB", "HSV": "RGB", "LAB": "RGB"}


class ImageError(ValueError):
    """An image that cannot be a map. The message says why."""


@dataclass(frozen=True)
class ScannedCells:
    """The cells of an image; row 0 is at the bottom."""

    free: Bools
    """[H, W] whether the cell is surely free."""
    unknown_as_free: Bools
    """[H, W] whether the cell has the grey for unknown and is free, since ``free_thresh`` is too high for this grey."""


def read_cells(path: Path, *, negate: bool, free_thresh: float) -> ScannedCells:
    """Read the cells of a map's image.

    Raises:
        ImageError: the file is not an image, is too large, or cannot be read without loss.
    """
    lightness, opaque = _lightness(path)
    occupied_prob = lightness if negate else 1.0 - lightness
    free = opaque & (occupied_prob < free_thresh)
    unknown = np.isclose(1.0 - lightness if negate else lightness, UNKNOWN_LIGHTNESS, atol=0.5 / 255)
    return ScannedCells(np.flipud(free), np.flipud(free & unknown))


def _lightness(path: Path) -> tuple[Floats, Bools]:
    """Return the mean [H, W] of each pixel's colours, between 0 and 1, and whether the pixel is opaque."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", Image.DecompressionBombWarning)  # the number of cells is checked below
            image = Image.open(path)
    except Image.DecompressionBombError:
        raise ImageError(f"has more than {MAX_CELLS} cells") from None
    except (OSError, UnidentifiedImageError, SyntaxError, ValueError) as error:
        raise ImageError(f"cannot be read as an image ({error})") from None
    with image:
        if image.width * image.height > MAX_CELLS:
            raise ImageError(f"{image.width} x {image.height} is more than {MAX_CELLS} cells")
        mode, largest = image.mode, _DIRECT.get(image.mode, 255.0)
        if mode == "I" and image.format == "PPM":  # Pillow scales larger ranges to 16 bits
            largest = 65535.0
        elif mode not in _DIRECT and mode not in _CONVERTED:
            raise ImageError(f"pixels of mode {mode} are not supported; save it as 8-bit greyscale PNG or PGM")
        try:
            values: NDArray[Any] = np.asarray(image.convert(_CONVERTED[mode]) if mode in _CONVERTED else image)
        except (OSError, SyntaxError, ValueError) as error:
            raise ImageError(f"cannot be read as an image ({error})") from None
    channels = np.atleast_3d(values).astype(np.float64) / largest
    if channels.shape[2] in (2, 4):
        return channels[..., :-1].mean(axis=2), channels[..., -1] == 1.0
    return channels.mean(axis=2), np.ones(values.shape[:2], dtype=bool)
