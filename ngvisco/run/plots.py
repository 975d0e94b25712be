"""Pictures of a run as PNG, PDF or SVG, drawn without a display (extra ``plots``: matplotlib)."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from ngsolve import CoefficientFunction, Mesh

from ngvisco.errors import NgviscoError, ParameterError, _is_number
from ngvisco.forms.term import PRODUCTION
from ngvisco.run.files import write_atomically
from ngvisco.run.outlines import outline
from ngvisco.run.vtu import Frame, cut, frame_of
from ngvisco.shapes.fractions import subdivision
from ngvisco.timestepping.integrator import LIMITER, LIMITER_WALLS

if TYPE_CHECKING:
    from ngvisco.run.ledger import Ledger


_OF_ENERGY = ("dissipation", "power")
"""Kinds of entries that are W: others are states, entropies, masses."""
PAGE, LABELS = 7.2, 9
"""Width of pictures, inches, that of a page; the size of the smallest labels, points."""
COLOURS, SHRINK = "viridis", 0.75
"""The scale of colours, and its length in heights of what it is beside."""
_LEVEL = 1e-10
"""Of a quantity: by less it is drawn as varying by nothing."""
_PIECES, _DRAWN = 6, 200_000  # of the sides of triangles, and triangles in all


class PlotError(NgviscoError, RuntimeError):
    """A picture cannot be drawn (matplotlib missing)."""


@dataclass(frozen=True)
class Section:
    """A plane normal to an axis, in which three-dimensional fields are shown.

    Parameters
    ----------
    normal : str
        ``"x"``, ``"y"`` or ``"z"``.
    at : float, optional
        Its coordinate along that axis, m; None (default) is the middle of the body.
    """

    normal: str = "z"
    at: float | None = None

    def __post_init__(self) -> None:
        if self.normal not in ("x", "y", "z"):
            raise ParameterError("Section.normal", self.normal, "x, y or z")
        if self.at is not None and not _is_number(self.at):
            raise ParameterError("Section.at", self.at, "a finite number")

    @classmethod
    def parse(cls, text: str) -> Section:
        """From ``"z"`` or ``"z=0.5"``."""
        normal, equals, value = text.replace(" ", "").partition("=")
        try:
            return cls(normal, float(value) if equals else None)
        except ValueError as error:
            if isinstance(error, ParameterError):
                raise
            raise ParameterError("Section.at", value, "a number, as in z=0.5") from error

    @property
    def normal_axis(self) -> int:
        return "xyz".index(self.normal)

    @property
    def axes(self) -> tuple[int, int]:
        """The two axes in the plane, to the right and upwards."""
        return ((1, 2), (0, 2), (0, 1))[self.normal_axis]

    def place(self, points: np.ndarray) -> float:
        """Its coordinate, m, in a body with these points; raises ParameterError when it misses the body."""
        along = points[:, self.normal_axis]
        low, high = float(along.min()), float(along.max())
        at = 0.5 * (low + high) if self.at is None else float(self.at)
        if not low <= at <= high:
            raise ParameterError(f"section {self.normal}", at, f"a coordinate from {low:g} to {high:g} m")
        return at


def require_space(section: Section | None, dim: int) -> None:
    """Raise ParameterError for a section of what is flat."""
    if section is not None and dim != 3:
        raise ParameterError("section", section.normal, "none: the mesh has two dimensions")


def titled(*parts: str | float) -> str:
    """A title of what there is: texts as they are, a number as the time in s."""
    return ", ".join(f"t = {part:.4g} s" if isinstance(part, float) else part for part in parts if part != "")


def figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """A matplotlib figure on the Agg canvas and its axes, (rows, columns); never opens a window."""
    try:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure
    except ImportError as error:
        raise PlotError('matplotlib is missing: pip install "ngvisco[plots]"') from error
    result = Figure(figsize=size, layout="constrained")
    FigureCanvasAgg(result)
    return result, result.subplots(rows, columns, squeeze=False)


def plot_energies(ledger: Ledger, path: str | os.PathLike[str]) -> None:
    """Energies and what was exchanged, and the closure, over time, as PNG, PDF or SVG by the path's end.

    Stored energy is drawn as its change since the start: its constant part is arbitrary.  Raises
    ParameterError for a ledger of a run that made no step; PlotError.
    """
    _require_steps("plot_energies.ledger", ledger)
    fig, ((above,), (below,)) = figure(2, 1, (PAGE, 7.5))
    t = ledger.column("time")
    above.plot(t, ledger.column("kinetic"), label="kinetic")
    above.plot(t, ledger.column("stored") - ledger.column("stored")[0], label="stored − initial")
    dt = ledger.column("dt")
    for entry in ledger.entries:
        label, column = entry.name.replace("_", " "), ledger.column(entry.name)
        if entry.kind == "monitor" and entry.name.startswith("stored_"):  # a share of what is stored
            above.plot(t, column - column[0], "-.", label=f"{label} − initial")
        if entry.kind not in (*_OF_ENERGY, "numerical"):
            continue  # no energy
        rate = column * (1 if entry.kind == "numerical" else dt)
        if entry.name in (LIMITER, LIMITER_WALLS) and not rate.any():
            continue  # nothing was limited: no line for it
        label = f"numerical: {label}" if entry.kind == "numerical" else label
        above.plot(t, np.cumsum(rate), "--" if entry.kind == "power" else ":", label=f"∫ {label}")
    above.set_ylabel("energy, J")
    above.legend(fontsize=LABELS, ncols=2, loc="lower center", bbox_to_anchor=(0.5, 1.0))
    closure = np.abs(ledger.column("closure_relative"))[1:]
    below.semilogy(t[1:], np.maximum(closure, 1e-18), "k.", label="|closure|, relative")
    below.set(xlabel="time, s", ylabel="relative", ylim=(1e-18, 1e-8))
    drift = np.maximum(np.abs(ledger.column("mass_drift"))[1:], 1e-18)
    below.semilogy(t[1:], drift, "r+", label="|mass drift|")
    below.legend(fontsize=LABELS)
    save(fig, path)


def plot_schemes(ledgers: Mapping[str, Ledger], path: str | os.PathLike[str]) -> None:
    """Kinetic energies of runs by different time schemes, and what each scheme and its model dissipated.

    Raises ParameterError if an argument is not what is said of it.

    Parameters
    ----------
    ledgers : mapping of labels to ledgers
        At most four, drawn solid, dashed, dotted and dash-dotted.
    path : path
        A picture.
    """
    for label, ledger in ledgers.items():
        _require_steps(f"plot_schemes.ledgers[{label!r}]", ledger)
    fig, ((left, right),) = figure(1, 2, (11, 4.6))
    for (label, ledger), style in zip(ledgers.items(), ("-", "--", ":", "-."), strict=False):
        t, dt = ledger.column("time"), ledger.column("dt")
        left.plot(t, ledger.column("kinetic"), f"C0{style}", label=label)
        for kind, whose, color in (("dissipation", "model", "C1"), ("numerical", "scheme", "C3")):
            unit = dt if kind == "dissipation" else 1.0  # W, or J already
            lost = np.cumsum(sum(unit * ledger.column(e.name) for e in ledger.entries if e.kind == kind))
            right.plot(t, lost, color + style, label=f"{label}, by the {whose}: {lost[-1]:.2g} J")
    for axis, title in ((left, "kinetic energy, J"), (right, "dissipated, J")):
        axis.set(title=title, xlabel="time, s")
        axis.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
    save(fig, path)


def plot_history(ledger: Ledger, path: str | os.PathLike[str]) -> None:
    """Dissipations and powers, extrema, iterations and step lengths over time, an axis for each quantity,
    and with heat the entropy's production and the temperature; formats as ``plot_energies``.  What varies by
    rounding is drawn as a level line."""
    _require_steps("plot_history.ledger", ledger)
    is_warm = "temperature_min" in ledger.columns
    fig, axes = figure(5 if is_warm else 4, 2, (PAGE, 11.9 if is_warm else 9.5))
    (rates, density), (volume, speed), (effort, rejected), (lengths, courant) = axes[:4]
    t = ledger.column("time")
    if is_warm:
        production, warmth = axes[4]
        for entry in ledger.entries:
            if entry.name.startswith(PRODUCTION):
                label = entry.name.removeprefix(PRODUCTION).replace("_", " ")
                production.plot(t[1:], ledger.column(entry.name)[1:], label=label)
        production.set(title="production of entropy, W/K")
        if production.lines:
            production.legend(fontsize=LABELS)
        warmth.plot(t, np.transpose([ledger.column(f"temperature_{end}") for end in ("min", "max")]))
        warmth.set(title="least and largest temperature, K")
    for entry in ledger.entries:
        if entry.kind in _OF_ENERGY:
            style = "--" if entry.kind == "power" else "-"
            rates.plot(t, ledger.column(entry.name), style, label=entry.name.replace("_", " "))
    rates.set(title="dissipations and powers, W")
    if rates.lines:
        rates.legend(fontsize=LABELS)
    density.plot(t, np.transpose([ledger.column(name) for name in ("rho_min", "rho_max")]))
    density.set(title="least and largest density, kg/m³")
    for axis, name, title in (
        (volume, "J_min", "least J"),
        (speed, "v_max", "largest |v|, m/s"),
        (effort, "newton_iterations", "Newton iterations of a step"),
        (rejected, "rejections", "rejected attempts of a step"),
        (lengths, "dt", "step length, s"),
        (courant, "cfl", "Courant number |v| dt/h"),
    ):
        values = ledger.column(name)
        if np.isnan(values).all():
            axis.text(0.5, 0.5, "the material has none", ha="center", va="center", transform=axis.transAxes)
        of_steps = 0 if axis in (volume, speed) else 1  # the start is no step
        axis.plot(t[of_steps:], values[of_steps:], "." if of_steps and len(t) < 200 else "-")
        axis.set(title=title)
        if of_steps:
            axis.set_ylim(0, 1.1 * float(values[1:].max()) or 1.0)
    for axis in axes[-1]:
        axis.set_xlabel("time, s")
    for axis in axes.ravel():
        axis.set_ylim(widened(*axis.get_ylim()))
    save(fig, path)


def widened(low: float, high: float) -> tuple[float, float]:
    """The range of a quantity, a tenth of it where it varies by rounding."""
    size = max(abs(low), abs(high))
    more = 0.05 * size if high - low < _LEVEL * size else 0.0
    return low - more, high + more


def plot_fields(
    mesh: Mesh,
    fields: Sequence[tuple[str, CoefficientFunction]],
    path: str | os.PathLike[str],
    section: Section | None = None,
    subdivisions: int = 3,
    title: str = "",
    outlines: Sequence[CoefficientFunction] = (),
) -> None:
    """Scalar fields in two columns; in 3D in a plane normal to an axis.  Formats as ``plot_energies``.

    Raises ParameterError if an argument is not what is said of it.

    Parameters
    ----------
    mesh : ngsolve.Mesh
    fields : sequence of (title, scalar coefficient function)
    path : path of the picture
    section : Section, optional
        In 3D the plane; default through the middle, normal to z.
    subdivisions : int
        Every cell is drawn as subdivisions^dim pieces, so that jumps between cells show.
    title : str
        Above all fields; in 3D the plane is added to it.
    outlines : sequence of scalar coefficient functions
        Volume fractions of bodies: drawn over each field as the line where they are one half.
    """
    require_space(section, mesh.dim)
    named = dict(fields)
    if not 0 < len(named) == len(fields):
        raise ParameterError(
            "plot_fields.fields", [name for name, _ in fields], "one field or more, by titles"
        )
    picture = Picture(frame_of(mesh, named, outlines, subdivisions), list(named), section)
    for name, axis, image in zip(named, picture.axes, picture.images, strict=True):
        axis.set_title(name)
        image.autoscale()
        image.set_clim(*widened(*image.get_clim()))
    picture.suptitle(title)
    save(picture.figure, path)


class Picture:
    """Scalar fields of a frame in two columns, each with a scale of colours; in 3D in a plane.

    Of another frame of the same cells they are drawn by ``show``.
    """

    def __init__(self, frame: Frame, names: Sequence[str], section: Section | None) -> None:
        self.names, self._plane = names, ""
        along = (0, 1)
        if frame.dim == 2:
            self._triangles = frame.cells
            self._ends = np.stack([np.arange(len(frame.points))] * 2, axis=1)
            self._share = np.zeros(len(frame.points))
        else:
            chosen = section or Section()
            at = chosen.place(frame.points)
            along, self._plane = chosen.axes, f"{chosen.normal} = {at:.4g} m"
            self._ends, self._share, self._triangles = cut(frame, chosen.normal_axis, at)
        self._points = self._between(frame.points)[:, along]
        # matplotlib mixes the colours of corners: between values that differ much these are not of the scale
        finer = int(np.clip((_DRAWN / len(self._triangles)) ** 0.5, 1, _PIECES))
        lattice, self._small = subdivision(2, finer)
        self._weights = np.column_stack([1 - lattice.sum(axis=1), lattice])
        self._lines: list[Any] = []
        self._draw([f"{'xyz'[i]}, m" for i in along])
        self.show(frame)

    def _draw(self, labels: Sequence[str]) -> None:
        wide, rows = min(len(self.names), 2), -(-len(self.names) // 2)
        extent = np.ptp(self._points, axis=0)
        ratio = float(np.clip(extent[1] / extent[0], 0.3, 2.0))
        height = 0.75 + 0.62 * PAGE / wide * ratio  # a field's, with title, labels and the scale beside it
        self.figure, axes = figure(rows, wide, (PAGE, rows * height + 0.4))
        self.axes = axes.ravel()[: len(self.names)]
        for axis in axes.ravel()[len(self.names) :]:
            axis.set_axis_off()
        X, Y = map(self._in_pieces, self._points.T)
        starts = np.arange(len(self._triangles)) * len(self._weights)
        pieces = np.add.outer(starts, self._small).reshape(-1, 3)
        self.images = []
        for axis in self.axes:
            style = {"shading": "gouraud", "cmap": COLOURS, "rasterized": True}
            self.images.append(axis.tripcolor(X, Y, pieces, np.zeros(len(X)), **style))
            axis.set(aspect="equal", xlabel=labels[0], ylabel=labels[1])
            self.figure.colorbar(self.images[-1], ax=axis, shrink=SHRINK)

    def _between(self, values: np.ndarray) -> np.ndarray:
        share = self._share.reshape((-1,) + (1,) * (values.ndim - 1))
        return (1 - share) * values[self._ends[:, 0]] + share * values[self._ends[:, 1]]

    def _in_pieces(self, values: np.ndarray) -> np.ndarray:
        """Of values at the corners of triangles those at the corners of their pieces."""
        return (values[self._triangles] @ self._weights.T).ravel()

    def show(self, frame: Frame) -> None:
        """Draw the fields of a frame, and the surfaces of its bodies, in place of the former one's."""
        for image, name in zip(self.images, self.names, strict=True):
            image.set_array(self._in_pieces(self._between(frame.scalar(name))))
        for line in self._lines:
            line.remove()
        X, Y = self._points.T
        shares = [self._between(fraction) for fraction in frame.fractions()]
        lines = [outline(axis, X, Y, self._triangles, share) for axis in self.axes for share in shares]
        self._lines = [line for line in lines if line is not None]

    def suptitle(self, *parts: str | float) -> None:
        """Write a title above all fields, in 3D with the plane."""
        if text := titled(*parts, self._plane):
            self.figure.suptitle(text)


def _require_steps(field: str, ledger: Ledger) -> None:
    """Raise ParameterError for a ledger without a step."""
    if len(ledger.rows) < 2:
        raise ParameterError(field, f"{len(ledger.rows)} rows", "a ledger of a run that made a step")


FORMATS = ("png", "pdf", "svg")


def save(fig: Any, path: str | os.PathLike[str]) -> None:
    target = Path(path)
    kind = target.suffix.lstrip(".").lower() or "png"
    if kind not in FORMATS:
        raise ParameterError("path of a picture", str(target), "a name that ends in .png, .pdf or .svg")
    image = io.BytesIO()
    fig.savefig(image, dpi=150, format=kind)
    write_atomically(target, image.getvalue())
