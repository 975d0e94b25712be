"""Animations of a run from its VTK series, by matplotlib's writers: gif by Pillow, mp4 by ffmpeg."""

from __future__ import annotations

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.run.fields import field_unit
from ngvisco.run.outlines import averaged, outline, outlined
from ngvisco.run.plots import (
    COLOURS,
    PAGE,
    SHRINK,
    PlotError,
    Section,
    figure,
    height_of,
    require_space,
    subdivision,
    titled,
)
from ngvisco.run.vtu import Frame, cut, read_frame, read_series_files

FORMATS = ("gif", "mp4")
_PIECES, _DRAWN = 6, 200_000  # of the sides of triangles, and triangles in all
_GREYS = 32  # of the colours of a .gif: lines and letters have smooth edges by them


def write_movie(
    series: str | os.PathLike[str],
    path: str | os.PathLike[str],
    fields: Sequence[str] | None = None,
    *,
    section: Section | None = None,
    frames_per_second: float = 10.0,
    title: str = "",
) -> None:
    """Animate scalar fields over the states of a VTK series, side by side, with one scale of colours each.

    Parameters
    ----------
    series : path
        Directory of a VTK series, e.g. ``results/swirl/vtk``.
    path : path
        What is written, ``.gif`` or ``.mp4``.
    fields : sequence of str, optional
        Names of the series' fields: of a vector its modulus or ``NAME_i``, of a tensor ``NAME_ij``; default
        density and modulus of the velocity, as far as the series has them.
    section : Section, optional
        In 3D the plane that is shown; default through the middle, normal to z.
    frames_per_second : float
        > 0.
    title : str

    Raises
    ------
    CheckpointError
        If there is no series, or a file of it cannot be read.
    UnknownNameError
        For a field that the series does not have.
    PlotError
        If matplotlib is missing, or for mp4 ffmpeg.
    """
    target = Path(path)
    kind = target.suffix.lstrip(".").lower()
    if kind not in FORMATS:
        raise ParameterError("write_movie.path", str(target), "a name that ends in .gif or .mp4")
    if not (isinstance(frames_per_second, (int, float)) and 0 < frames_per_second <= 1000):
        raise ParameterError("write_movie.frames_per_second", frames_per_second, "a number in (0, 1000]")
    files = read_series_files(series)
    first = read_frame(files[0][1])
    require_space(section, first.dim)
    names = list(fields) if fields is not None else [n for n in ("density", "velocity") if n in first.fields]
    if not names:
        raise ParameterError("write_movie.fields", fields, "at least one field of the series")
    ranges = _ranges([file for _, file in files], names)
    wide = min(len(names), 2)
    rows = -(-len(names) // 2)
    fig, axes = figure(rows, wide, (PAGE, rows * _height(first, section, PAGE / wide) + 0.4))
    for axis in axes.ravel()[len(names) :]:
        axis.set_axis_off()
    axes = axes.ravel()[: len(names)]
    picture = _Picture(first, section)
    images = [
        picture.draw(fig, axis, name, limits) for axis, name, limits in zip(axes, names, ranges, strict=True)
    ]
    draft = target.with_name(f"{target.stem}.part{target.suffix}")
    target.parent.mkdir(parents=True, exist_ok=True)
    writer = _writer(kind, frames_per_second)
    try:
        with writer.saving(fig, str(draft), dpi=130):
            lines: list[Any] = []
            for time, file in files:
                frame = read_frame(file)
                for image, name in zip(images, names, strict=True):
                    image.set_array(picture.values(frame, name))
                lines = picture.outlined(frame, axes, lines)
                fig.suptitle(titled(title, time, picture.section_text))
                writer.grab_frame()
        draft.replace(target)
    finally:
        draft.unlink(missing_ok=True)


def _writer(kind: str, rate: float) -> Any:
    from matplotlib import rcParams
    from matplotlib.animation import FFMpegWriter, PillowWriter

    if kind == "gif":

        class Gif(PillowWriter):
            """In the colours of the scale and greys: of 256 that Pillow chooses a scale has steps."""

            def finish(self) -> None:
                frames = vars(self)["_frames"]
                palette = _palette(frames[0])
                frames[:] = [frame.convert("RGB").quantize(palette=palette, dither=0) for frame in frames]
                super().finish()

        return Gif(fps=rate)  # type: ignore[arg-type]
    if shutil.which(rcParams["animation.ffmpeg_path"]) is None:
        raise PlotError("an mp4 needs ffmpeg, which is not on the path: install it, or ask for a .gif")
    # even sizes, which the codec wants
    return FFMpegWriter(fps=rate, extra_args=["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2", "-pix_fmt", "yuv420p"])  # type: ignore[arg-type]


def _palette(frame: Any) -> Any:
    """An image with the 256 colours of an animation."""
    from matplotlib import colormaps

    scale = colormaps[COLOURS](np.linspace(0, 1, 256 - _GREYS))[:, :3]
    greys = np.linspace(0, 1, _GREYS)[:, None] * np.ones(3)
    image = frame.convert("P")
    image.putpalette(np.round(255 * np.concatenate([scale, greys])).astype(np.uint8).tobytes())
    return image


def _ranges(files: Sequence[Path], names: Sequence[str]) -> list[tuple[float, float]]:
    """Smallest and largest value of each field over all states."""
    low, high = np.full(len(names), np.inf), np.full(len(names), -np.inf)
    for file in files:
        frame = read_frame(file)
        for i, name in enumerate(names):
            values = frame.scalar(name)
            low[i], high[i] = min(low[i], values.min()), max(high[i], values.max())
    return [
        (float(a), float(b)) if b > a else (float(a) - 0.5, float(a) + 0.5)
        for a, b in zip(low, high, strict=True)
    ]


def _height(frame: Frame, section: Section | None, width: float) -> float:
    """Of a picture of this width, inches."""
    extent = np.ptp(frame.points, axis=0)
    i, j = (0, 1) if frame.dim == 2 else (section or Section()).axes
    return height_of(width, float(extent[j] / extent[i]))


class _Picture:
    """What is the same in all frames: the triangles that are drawn, in two dimensions."""

    def __init__(self, frame: Frame, section: Section | None) -> None:
        self.section_text, self._axes = "", (0, 1)
        if frame.dim == 2:
            self._triangles = frame.cells
            self._ends = np.stack([np.arange(len(frame.points))] * 2, axis=1)
            self._share = np.zeros(len(frame.points))
        else:
            chosen = section or Section()
            at = chosen.place(frame.points)
            self._axes, self.section_text = chosen.axes, chosen.text(at)
            self._ends, self._share, self._triangles = cut(frame, chosen.normal_axis, at)
            if not len(self._triangles):
                raise ParameterError("section", self.section_text, "a plane that meets the body")
        self._points = self._between(frame.points)[:, self._axes]
        # matplotlib mixes the colours of corners: between values that differ much these are not of the scale
        finer = int(np.clip((_DRAWN / len(self._triangles)) ** 0.5, 1, _PIECES))
        lattice, self._small = subdivision(finer)
        self._weights = np.column_stack([1 - lattice.sum(axis=1), lattice])

    def _between(self, values: np.ndarray) -> np.ndarray:
        share = self._share.reshape((-1,) + (1,) * (values.ndim - 1))
        return (1 - share) * values[self._ends[:, 0]] + share * values[self._ends[:, 1]]

    def _in_pieces(self, values: np.ndarray) -> np.ndarray:
        """Of values at the corners of triangles those at the corners of their pieces."""
        return (values[self._triangles] @ self._weights.T).ravel()

    def values(self, frame: Frame, name: str) -> np.ndarray:
        return self._in_pieces(self._between(frame.scalar(name)))

    def outlined(self, frame: Frame, axes: Sequence[Any], former: Sequence[Any]) -> list[Any]:
        """Draw the surfaces of bodies in a frame, in place of the former one's."""
        for line in former:
            line.remove()
        X, Y = self._points.T
        names = outlined(list(frame.fields))
        fractions = [self._between(averaged(frame.points, frame.scalar(name))) for name in names]
        lines = [outline(axis, X, Y, self._triangles, share) for axis in axes for share in fractions]
        return [line for line in lines if line is not None]

    def draw(self, fig: Any, axis: Any, name: str, limits: tuple[float, float]) -> Any:
        X, Y = map(self._in_pieces, self._points.T)
        starts = np.arange(len(self._triangles)) * len(self._weights)
        pieces = np.add.outer(starts, self._small).reshape(-1, 3)
        image = axis.tripcolor(X, Y, pieces, np.zeros(len(X)), shading="gouraud", cmap=COLOURS)
        image.set_clim(*limits)
        unit = field_unit(name)
        labels = [f"{'xyz'[i]}, m" for i in self._axes]
        axis.set(aspect="equal", xlabel=labels[0], ylabel=labels[1])
        axis.set_title(name.replace("_", " ") + (f", {unit}" if unit else ""))
        fig.colorbar(image, ax=axis, shrink=SHRINK)
        return image
