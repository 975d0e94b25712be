"""Animations of a run from its VTK series, by matplotlib's writers: gif by Pillow, mp4 by ffmpeg."""

import os
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ngvisco.errors import ParameterError
from ngvisco.run.fields import title_of
from ngvisco.run.plots import COLOURS, Picture, PlotError, Section, require_space
from ngvisco.run.vtu import read_frame, read_series_files

FORMATS = ("gif", "mp4")
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

    Raises CheckpointError if there is no series, or a file of it cannot be read; UnknownNameError for a
    field that the series does not have; PlotError if matplotlib is missing, or for mp4 ffmpeg.

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
    picture = Picture(first, names, section)
    for name, axis, image, limits in zip(names, picture.axes, picture.images, ranges, strict=True):
        axis.set_title(title_of(name))
        image.set_clim(*limits)
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
