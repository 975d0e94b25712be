"""Pictures of fields over the body, and animations of a VTK series (gif by Pillow, mp4 by ffmpeg)."""

from __future__ import annotations

import importlib
import io
import shutil
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.errors import NgviscoError, ParameterError, as_number
from ngvisco.run.fields import title_of
from ngvisco.run.files import AnyPath, write_atomically
from ngvisco.run.frames import Frame, cut, frame_of, outline, read_frame, read_series_files
from ngvisco.shapes.fractions import subdivision

PAGE, LABELS = 7.2, 9
"""Width of pictures, which fits a page, in inches; and size of the smallest labels, points."""
FORMATS = ("png", "pdf", "svg")
_LEVEL = 1e-10
"""Relative variation below which a quantity is drawn as constant."""
_COLOURS, _SHRINK = "viridis", 0.75
"""The scale of colours, and the ratio of the scale's length to the height of its axes."""
_PIECES, _DRAWN = 6, 200_000  # largest numbers: parts of a triangle's side, and triangles of a picture
# two percentiles; a range between them below this share of the whole range shows a spike
_USUAL, _SPIKE = (0.5, 99.5), 0.3
# shares of the largest rate: a median below the first makes the scale logarithmic; the second is the least
# value of this scale
_ORDERS, _DECADES = 1e-2, 1e-6
_UNITS = (("km", 1e3, 2e3), ("m", 1.0, 0.1), ("mm", 1e-3, 1e-4), ("µm", 1e-6, 1e-7), ("nm", 1e-9, 0.0))
"""Units of length: name, size in m, and least length in m that is shown in the unit."""
_MARKS, _MARGIN = 5, 0.02  # number of labels along the longer side, and the margin's share of the body's side
_GREYS = 32  # number of greys in a .gif, for smooth edges of lines and letters


class PlotError(NgviscoError, RuntimeError):
    """A picture cannot be drawn (matplotlib missing)."""


def figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """A matplotlib figure on the Agg canvas and its axes, (rows, columns); no window opens."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PlotError('matplotlib is missing; run pip install "ngvisco[plots]"') from error
    result = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(result)
    return result, result.subplots(rows, columns, squeeze=False)


def save(fig: Any, path: AnyPath) -> None:
    target = Path(path)
    kind = target.suffix.lstrip(".").lower() or "png"
    if kind not in FORMATS:
        raise ParameterError("path of a picture", str(target), "a name that ends in .png, .pdf or .svg")
    image = io.BytesIO()
    fig.savefig(image, dpi=150, format=kind)
    write_atomically(target, image.getvalue())


def widened(low: float, high: float) -> tuple[float, float]:
    """The range of a quantity.

    A quantity that varies by rounding only gets a range around its value, with a tenth of the value's size.
    """
    size = max(abs(low), abs(high))
    more = 0.05 * size if high - low < _LEVEL * size else 0.0
    return low - more, high + more


@dataclass(frozen=True)
class Colours:
    """A scale of colours: matplotlib's norm, and ``extend``, the ends beyond which values lie."""

    norm: Any
    extend: str

    @classmethod
    def of(cls, name: str, values: np.ndarray) -> Colours:
        """The scale for a field's values, from the least to the largest value without spikes.

        If most values lie in a small part of the whole range, the scale has this smaller range. Positive
        rates that differ by orders of magnitude have a logarithmic scale.
        """
        norms = importlib.import_module("matplotlib.colors")
        low, high = float(values.min()), float(values.max())
        if is_rate(name) and high > 0 and low >= 0 and np.median(values) < _ORDERS * high:
            least = max(float(np.percentile(values, _USUAL[0])), _DECADES * high)
            return cls(norms.LogNorm(least, high), "min" if low < least else "neither")
        usual = np.percentile(values, _USUAL)
        if 0 < usual[1] - usual[0] < _SPIKE * (high - low):
            ends = {(True, True): "both", (True, False): "min", (False, True): "max"}
            return cls(norms.Normalize(*usual), ends[bool(low < usual[0]), bool(high > usual[1])])
        return cls(norms.Normalize(*widened(low, high)), "neither")


def is_rate(name: str) -> bool:
    """Whether a field with this name or title is a rate of strain."""
    return "rate" in name or name.endswith("1/s")


def unit_of_length(size: float) -> tuple[str, float]:
    """The unit in which a length of ``size`` (m) is shown, and the unit's size, m."""
    return next((name, metres) for name, metres, least in _UNITS if size >= least)


@dataclass(frozen=True)
class CrossSection:
    """A plane normal to an axis, "x", "y" or "z", in which three-dimensional fields are shown.

    ``at`` is the plane's coordinate along that axis, m; None (default) is the middle of the body.
    """

    normal: str = "z"
    at: float | None = None

    def __post_init__(self) -> None:
        if self.normal not in ("x", "y", "z"):
            raise ParameterError("section.normal", self.normal, "x, y or z")
        if self.at is not None and as_number(self.at) is None:
            raise ParameterError("section.at", self.at, "a finite number")

    @classmethod
    def parse(cls, text: str) -> CrossSection:
        """The section that ``"z"`` or ``"z=0.5"`` describes."""
        normal, equals, value = text.replace(" ", "").partition("=")
        try:
            at = float(value) if equals else None
        except ValueError as error:
            raise ParameterError("section.at", value, "a number, as in z=0.5") from error
        return cls(normal, at)

    @property
    def axis(self) -> int:
        return "xyz".index(self.normal)

    def place(self, points: np.ndarray) -> float:
        """The plane's coordinate, m, in a body with these points; raises ParameterError if it misses them."""
        along = points[:, self.axis]
        low, high = float(along.min()), float(along.max())
        at = 0.5 * (low + high) if self.at is None else float(self.at)
        if not low <= at <= high:
            raise ParameterError(f"section {self.normal}", at, f"a coordinate from {low:g} to {high:g} m")
        return at


def require_space(section: CrossSection | None, dim: int) -> None:
    """Raise ParameterError for a section of a mesh of two dimensions."""
    if section is not None and dim != 3:
        raise ParameterError("section", section.normal, "no section, since the mesh has two dimensions")


def titled(*parts: str | float) -> str:
    """A title from parts: texts as they are, a number as the time in s; empty texts are left out."""
    return ", ".join(f"t = {part:.4g} s" if isinstance(part, float) else part for part in parts if part != "")


def plot_fields(
    mesh: Mesh,
    fields: Sequence[tuple[str, CoefficientFunction]],
    path: AnyPath,
    section: CrossSection | None = None,
    subdivisions: int = 3,
    title: str = "",
    outlines: Sequence[CoefficientFunction] = (),
) -> None:
    """Plot scalar fields in two columns, in 3D in a plane normal to an axis, as PNG, PDF or SVG.

    Raises ParameterError for an argument that does not fit its description.

    Parameters
    ----------
    fields : sequence of (title, scalar coefficient function)
    section : CrossSection, optional
        The plane in 3D; default through the middle, normal to z.
    subdivisions : int
        Number of parts of a cell's side; a cell is drawn as subdivisions^dim pieces, so that jumps show.
    title : str
        Title above all fields; in 3D the plane is added to it.
    outlines : sequence of scalar coefficient functions
        Volume fractions of bodies; the lines where they are one half are drawn over each field.
    """
    require_space(section, mesh.dim)
    named = dict(fields)
    if not 0 < len(named) == len(fields):
        expected = "at least one field, and a different title for each field"
        raise ParameterError("plot_fields.fields", [name for name, _ in fields], expected)
    picture = _Picture(frame_of(mesh, named, outlines, subdivisions), list(named), section)
    for name, axis in zip(named, picture.axes, strict=True):
        axis.set_title(name)
    picture.suptitle(title)
    save(picture.figure, path)


class _Picture:
    """Scalar fields of a frame in two columns, each with a scale of colours, and outlines of bodies; in 3D in
    a plane.  ``show`` draws another frame with the same scales."""

    def __init__(self, frame: Frame, names: Sequence[str], section: CrossSection | None) -> None:
        self._names, self._section, self._plane = names, section or CrossSection(), ""
        self._unit, self._metres = unit_of_length(float(np.ptp(frame.points, axis=0).max()))
        if frame.dim == 3:
            self._plane = f"{self._section.normal} = {self._section.place(frame.points):.4g} m"
        wide, rows = min(len(names), 2), -(-len(names) // 2)
        corners = self._corners(frame)[0]
        extent = np.ptp(corners, axis=0)
        ratio = float(np.clip(extent[1] / extent[0], 0.3, 2.0))
        height = 0.75 + 0.62 * PAGE / wide * ratio  # inches for a field with title, labels and scale
        self.figure, axes = figure(rows, wide, (PAGE, rows * height + 0.4))
        self.axes = axes.ravel()[: len(names)]
        _, _, between = self._corners(frame)
        colours = [Colours.of(name, between(frame.scalar(name))) for name in names]
        for axis in axes.ravel()[len(names) :]:
            axis.set_axis_off()
        scalar_mappable = importlib.import_module("matplotlib.cm").ScalarMappable
        self.scales = [scalar_mappable(cmap=_COLOURS, norm=colouring.norm) for colouring in colours]
        across = "xyz".replace(self._section.normal, "") if frame.dim == 3 else "xy"
        for axis, scale, colouring in zip(self.axes, self.scales, colours, strict=True):
            axis.set(aspect="equal")
            axis.margins(_MARGIN)
            for letter, along, side in zip(across, (axis.xaxis, axis.yaxis), corners.T, strict=True):
                self._mark(letter, along, side, extent.max())
            self.figure.colorbar(scale, ax=axis, shrink=_SHRINK, extend=colouring.extend)
        self.images: list[Any] = []
        self._lines: list[Any] = []
        self.show(frame)

    def _mark(self, letter: str, along: Any, side: np.ndarray, longest: float) -> None:
        """Label an axis with its name and with numbers; a short side of the body has fewer numbers."""
        ends, share = (float(side.min()), float(side.max())), float(np.ptp(side)) / longest
        label = f"{letter}, {self._unit}"
        if share > 0.45:
            along.set_major_locator(importlib.import_module("matplotlib.ticker").MaxNLocator(_MARKS))
        elif share > 0.12:
            along.set_ticks(ends, [f"{end:.4g}" for end in ends])
        else:
            along.set_ticks([])
            label = f"{letter}: {ends[0]:.4g}\nto {ends[1]:.4g} {self._unit}"
        if share <= 0.12 and along.axis_name == "y":
            along.set_label_text(label, rotation=0, ha="right", va="center")
        else:
            along.set_label_text(label)

    def _corners(self, frame: Frame) -> tuple[np.ndarray, np.ndarray, Callable[[np.ndarray], np.ndarray]]:
        """Corners in the plane, (corners, 2), their triangles, and the map of the frame's values to them."""
        if frame.dim == 2:
            return frame.points[:, :2] / self._metres, frame.cells, lambda values: values
        axis = self._section.axis
        ends, share, triangles = cut(frame, axis, self._section.place(frame.points))

        def between(values: np.ndarray) -> np.ndarray:
            return ((1 - share) * values[ends[:, 0]].T + share * values[ends[:, 1]].T).T

        return np.delete(between(frame.points), axis, axis=1) / self._metres, triangles, between

    def show(self, frame: Frame) -> None:
        """Draw the fields of a frame, and the outlines of its bodies, in place of the former frame."""
        for artist in [*self.images, *self._lines]:
            artist.remove()
        points, triangles, between = self._corners(frame)
        # matplotlib mixes the colours of corners, and a mixture of very different colours is not on the scale
        lattice, small = subdivision(2, int(np.clip((_DRAWN / len(triangles)) ** 0.5, 1, _PIECES)))
        weights = np.column_stack([1 - lattice.sum(axis=1), lattice])
        pieces = np.add.outer(np.arange(len(triangles)) * len(weights), small).reshape(-1, 3)

        def in_pieces(values: np.ndarray) -> np.ndarray:
            return (values[triangles] @ weights.T).ravel()

        (X, Y), (U, V) = map(in_pieces, points.T), points.T
        bodies = [between(fraction) for fraction in frame.fractions()]
        self.images, lines = [], []
        for axis, name, scale in zip(self.axes, self._names, self.scales, strict=True):
            values = in_pieces(between(frame.scalar(name)))
            style = {"shading": "gouraud", "cmap": _COLOURS, "norm": scale.norm, "rasterized": True}
            self.images.append(axis.tripcolor(X, Y, pieces, values, **style))
            lines += [outline(axis, U, V, triangles, fraction) for fraction in bodies]
        self._lines = [line for line in lines if line is not None]

    def suptitle(self, *parts: str | float) -> None:
        if text := titled(*parts, self._plane):
            self.figure.suptitle(text)


def write_movie(
    series: AnyPath,
    path: AnyPath,
    fields: Sequence[str] | None = None,
    *,
    section: CrossSection | None = None,
    frames_per_second: float = 10.0,
    title: str = "",
) -> None:
    """Animate scalar fields over the states of a VTK series, side by side, with one scale of colours each.

    Raises CheckpointError if there is no series, or one of its files cannot be read; UnknownNameError for a
    field that the series does not have; PlotError if matplotlib is missing, or ffmpeg for an mp4.

    Parameters
    ----------
    series, path : path
        Directory of the series, e.g. ``results/swirl/vtk``, and the animation's file, ``.gif`` or ``.mp4``.
    fields : sequence of str, optional
        Names of scalars, of vectors for their modulus, or of components, ``NAME_i`` and ``NAME_ij``; default
        density and modulus of the velocity, if the series has them.
    section : CrossSection, optional
        The plane that is shown in 3D; default through the middle, normal to z.
    """
    target = Path(path)
    kind = target.suffix.lstrip(".").lower()
    if kind not in ("gif", "mp4"):
        raise ParameterError("write_movie.path", str(target), "a name that ends in .gif or .mp4")
    if not (isinstance(frames_per_second, (int, float)) and 0 < frames_per_second <= 1000):
        raise ParameterError("write_movie.frames_per_second", frames_per_second, "a number in (0, 1000]")
    files = read_series_files(series)
    first = read_frame(files[0][1])
    require_space(section, first.dim)
    names = list(fields) if fields is not None else [n for n in ("density", "velocity") if n in first.fields]
    if not names:
        raise ParameterError("write_movie.fields", fields, "at least one field of the series")
    ranges = np.array([[_usual_range(v) for v in map(read_frame(file).scalar, names)] for _, file in files])
    picture = _Picture(first, names, section)
    for i, name in enumerate(names):
        low, high = float(ranges[:, i, 0].min()), float(ranges[:, i, 1].max())
        picture.axes[i].set_title(title_of(name))
        if picture.scales[i].norm.vmin > 0 and is_rate(name):
            low = max(low, _DECADES * high)
        picture.scales[i].set_clim(*((low, high) if high > low else (low - 0.5, low + 0.5)))
    draft = target.with_name(f"{target.stem}.part{target.suffix}")
    target.parent.mkdir(parents=True, exist_ok=True)
    writer = _writer(kind, frames_per_second)
    try:
        with writer.saving(picture.figure, str(draft), dpi=130):
            for time, file in files:
                picture.show(read_frame(file))
                picture.suptitle(title, time)
                writer.grab_frame()
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def _usual_range(values: np.ndarray) -> tuple[float, float]:
    norm = Colours.of("", values).norm
    return float(norm.vmin), float(norm.vmax)


def _writer(kind: str, rate: float) -> Any:
    from matplotlib import colormaps, rcParams
    from matplotlib.animation import FFMpegWriter, PillowWriter

    if kind == "mp4":
        if shutil.which(rcParams["animation.ffmpeg_path"]) is None:
            raise PlotError(
                "an mp4 needs ffmpeg, which is not on the path; install ffmpeg, or choose a name that ends "
                "in .gif"
            )
        even = "pad=ceil(iw/2)*2:ceil(ih/2)*2"  # the codec needs even sizes
        return FFMpegWriter(fps=rate, extra_args=["-vf", even, "-pix_fmt", "yuv420p"])  # type: ignore[arg-type]

    class Gif(PillowWriter):
        """Write a gif whose palette has the colours of the scale and greys. With 256 colours chosen by Pillow
        the scale would have steps."""

        def finish(self) -> None:
            frames = vars(self)["_frames"]
            scale = colormaps[_COLOURS](np.linspace(0, 1, 256 - _GREYS))[:, :3]
            greys = np.linspace(0, 1, _GREYS)[:, None] * np.ones(3)
            palette = frames[0].convert("P")
            palette.putpalette(np.round(255 * np.concatenate([scale, greys])).astype(np.uint8).tobytes())
            frames[:] = [frame.convert("RGB").quantize(palette=palette, dither=0) for frame in frames]
            super().finish()

    return Gif(fps=rate)  # type: ignore[arg-type]
