"""Shapes from pictures: where a PNG file is dark."""

import importlib
import os
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np

from ngvisco.errors import ParameterError, Quantity, as_place, require_path, require_ranges, require_type
from ngvisco.shapes.places import Places
from ngvisco.shapes.shape import Shape, require_dim

_LUMA = np.array([0.299, 0.587, 0.114])  # of red, green, blue in a grey


@dataclass(frozen=True)
class Image(Shape):
    """Where a picture is dark, in the plane; read by matplotlib (extra ``plots``).

    Raises ParameterError if the file is missing or no PNG, or matplotlib is.

    Parameters
    ----------
    path : path
        A PNG file, grey or in colours, in a case file relative to it; what is transparent counts as white.
    low : pair of numbers
        Place of the picture's lower left corner; outside of it there is nothing.
    high : pair of numbers
        Place of its upper right corner.
    threshold : float
        Grey, from 0 (black) to 1 (white), below which a pixel belongs to it; between the middles of pixels
        the grey is interpolated.
    dark : bool
        If false, what is brighter than the threshold instead.
    """

    path: Annotated[str | os.PathLike[str], Quantity(example="part.png")]
    low: Annotated[tuple[float, float], Quantity("m", example=[0.0, 0.0])]
    high: Annotated[tuple[float, float], Quantity("m", example=[1.0, 1.0])]
    threshold: Annotated[float, Quantity("1", "in (0, 1)")] = 0.5
    dark: bool = True

    def __post_init__(self) -> None:
        object.__setattr__(self, "path", str(require_path("Image.path", self.path)))
        low, high = as_place("Image.low", self.low), as_place("Image.high", self.high)
        if len(low) != 2 or len(high) != 2 or not (low[0] < high[0] and low[1] < high[1]):
            raise ParameterError("Image.high", self.high, f"two coordinates above those of low = {low}")
        object.__setattr__(self, "low", low)
        object.__setattr__(self, "high", high)
        require_ranges(self)
        require_type("Image.dark", self.dark, bool)
        self.grey  # read and checked  # noqa: B018

    @cached_property
    def grey(self) -> np.ndarray:
        """0 (black) to 1 (white), (columns from the left, rows from below)."""
        try:
            image = importlib.import_module("matplotlib.image")
        except ImportError as error:
            expected = 'matplotlib to read it: pip install "ngvisco[plots]"'
            raise ParameterError("Image.path", self.path, expected) from error
        if Path(self.path).suffix.lower() != ".png":
            raise ParameterError("Image.path", self.path, "a PNG file, with a name that ends in .png")
        try:
            pixels = np.asarray(image.imread(self.path), dtype=float)
        except (OSError, SyntaxError, ValueError) as error:
            raise ParameterError("Image.path", self.path, f"a readable PNG file ({error})") from error
        if pixels.ndim == 3:
            alpha = pixels[..., -1] if pixels.shape[2] in (2, 4) else 1.0
            colour = pixels[..., :3] @ _LUMA if pixels.shape[2] >= 3 else pixels[..., 0]
            pixels = alpha * colour + (1 - alpha)
        return pixels[::-1].T

    def level(self, at: Places) -> np.ndarray:
        require_dim("Image.low", self.low, at.mesh)
        low, size, count = np.array(self.low), np.subtract(self.high, self.low), np.array(self.grey.shape)
        darkness = (self.threshold - self.grey) * (1 if self.dark else -1)
        from scipy.interpolate import RegularGridInterpolator  # a fifth of the package's time to be imported

        # middles of pixels; the edges' pixels reach to the edges
        padded = np.pad(darkness, 1, mode="edge")
        axes = [np.arange(-0.5, n + 1) for n in count]
        pixels = (at.coordinates - low) / size * count
        inside = ((pixels >= 0) & (pixels <= count)).all(axis=1)
        result = np.full(len(pixels), -1.0)
        result[inside] = RegularGridInterpolator(axes, padded)(pixels[inside])
        return result
