"""Pictures of a run as PNG, PDF or SVG, drawn without a display (extra ``plots``: matplotlib)."""

from __future__ import annotations

import io
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from ngsolve import ET, VOL, CoefficientFunction, IntegrationRule, Mesh, x, y

from ngvisco.errors import NgviscoError, ParameterError, _is_number
from ngvisco.forms.mesh.mesh_arrays import coordinates
from ngvisco.run.files import write_atomically
from ngvisco.run.outlines import OUTLINE, averaged, has_outline, outline
from ngvisco.timestepping.integrator import LIMITER, LIMITER_WALLS

if TYPE_CHECKING:
    from ngvisco.run.ledger import Ledger


PAGE, LABELS = 7.2, 9
"""Width of pictures, inches, that of a page; the size of the smallest labels, points."""
COLOURS, SHRINK = "viridis", 0.75
"""The scale of colours, and its length in heights of what it is beside."""


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
        """Its coordinate, m, for a body with these points; raises ParameterError when it misses the body."""
        along = points[:, self.normal_axis]
        low, high = float(along.min()), float(along.max())
        at = 0.5 * (low + high) if self.at is None else float(self.at)
        if not low <= at <= high:
            raise ParameterError(f"section {self.normal}", at, f"a coordinate from {low:g} to {high:g} m")
        return at

    def text(self, at: float) -> str:
        """How a title says it."""
        return f"{self.normal} = {at:.4g} m"


def require_space(section: Section | None, dim: int) -> None:
    """Raise ParameterError for a section of what is flat."""
    if section is not None and dim != 3:
        raise ParameterError("section", section.normal, "none: the mesh has two dimensions")


def height_of(width: float, ratio: float) -> float:
    """Height of a field's picture, inches, with its title and labels; ``ratio`` is height over width of what
    it shows, beside which there is a scale of colours."""
    return 0.75 + 0.62 * width * min(max(ratio, 0.3), 2.0)


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

    Stored energy is drawn as its change since the start: its constant part is arbitrary.

    Raises
    ------
    ParameterError
        For a ledger of a run that made no step.
    PlotError
    """
    _require_steps("plot_energies.ledger", ledger)
    fig, ((above,), (below,)) = figure(2, 1, (PAGE, 7.5))
    t = ledger.column("time")
    above.plot(t, ledger.column("kinetic"), label="kinetic")
    above.plot(t, ledger.column("stored") - ledger.column("stored")[0], label="stored − initial")
    dt = ledger.column("dt")
    for entry in ledger.entries:
        rate = ledger.column(entry.name) * (1 if entry.kind == "numerical" else dt)
        if entry.name in (LIMITER, LIMITER_WALLS) and not rate.any():
            continue  # nothing was limited: no line for it
        label = entry.name.replace("_", " ")
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
    """Dissipations and powers, extrema, iterations and step lengths over time, an axis for each quantity;
    formats as ``plot_energies``."""
    _require_steps("plot_history.ledger", ledger)
    fig, axes = figure(4, 2, (PAGE, 9.5))
    (rates, density), (volume, speed), (effort, rejected), (lengths, courant) = axes
    t = ledger.column("time")
    for entry in ledger.entries:
        if entry.kind != "numerical":
            style = "--" if entry.kind == "power" else "-"
            rates.plot(t, ledger.column(entry.name), style, label=entry.name.replace("_", " "))
    rates.set(title="dissipations and powers, W")
    if rates.lines:
        rates.legend(fontsize=LABELS)
    for name, label in (("rho_min", "min"), ("rho_max", "max")):
        density.plot(t, ledger.column(name), label=label)
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
    save(fig, path)


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

    Parameters
    ----------
    mesh : ngsolve.Mesh
    fields : sequence of (title, scalar coefficient function)
    path : path of the picture
    section : Section, optional
        In 3D the plane; default through the middle, normal to z.
    subdivisions : int
        In 2D every cell is drawn as subdivisions^2 triangles, so that jumps between cells show.
    title : str
        Above all fields; in 3D the plane is added to it.
    outlines : sequence of scalar coefficient functions
        Volume fractions of bodies: drawn over each field as the line where they are one half.
    """
    for name, value in fields:
        if value.dim != 1:
            raise ParameterError(f"plot_fields field {name!r}", value.dim, "a scalar")
    require_space(section, mesh.dim)
    corners = coordinates(mesh)
    chosen = section or Section()
    along = chosen.axes if mesh.dim == 3 else (0, 1)
    extent = np.ptp(corners, axis=0)
    wide = min(len(fields), 2)
    rows = -(-len(fields) // 2)
    height = height_of(PAGE / wide, float(extent[along[1]] / extent[along[0]]))
    fig, axes = figure(rows, wide, (PAGE, rows * height + 0.3))
    for axis in axes.ravel()[len(fields) :]:
        axis.set_axis_off()
    for axis, (name, value) in zip(axes.ravel(), fields, strict=False):
        if mesh.dim == 3:
            image = _draw_plane(axis, mesh, value, chosen, outlines)
        else:
            image = _draw_cells(axis, mesh, value, subdivisions, outlines)
        labels = [f"{'xyz'[i]}, m" for i in along]
        axis.set(title=name, aspect="equal", xlabel=labels[0], ylabel=labels[1])
        fig.colorbar(image, ax=axis, shrink=SHRINK)
    plane = chosen.text(chosen.place(corners)) if mesh.dim == 3 else ""
    if title or plane:
        fig.suptitle(titled(title, plane))
    save(fig, path)


def subdivision(n: int) -> tuple[np.ndarray, np.ndarray]:
    """Points of a lattice in the reference triangle, (points, 2), and its n^2 triangles of them."""
    index = {p: k for k, p in enumerate((i, j) for j in range(n + 1) for i in range(n + 1 - j))}
    small = []
    for i, j in index:
        if i + j < n:
            small.append((index[i, j], index[i + 1, j], index[i, j + 1]))
        if i + j < n - 1:
            small.append((index[i + 1, j], index[i + 1, j + 1], index[i, j + 1]))
    return np.array(list(index)) / n, np.array(small)


def _draw_cells(
    axis: Any,
    mesh: Mesh,
    value: CoefficientFunction,
    subdivisions: float,
    outlines: Sequence[CoefficientFunction],
) -> Any:
    """Every triangle (or quadrilateral) by its own points: nothing is averaged between cells."""
    lattice, small = subdivision(int(subdivisions))
    rule = IntegrationRule([tuple(point) for point in lattice], [0.0] * len(lattice))
    points = mesh.MapToAllElements({ET.TRIG: rule, ET.QUAD: rule}, VOL)
    X, Y, values = (np.asarray(f(points)).ravel() for f in (x, y, value))
    cells = len(X) // len(lattice)
    triangles = np.add.outer(np.arange(cells) * len(lattice), small).reshape(-1, 3)
    image = axis.tripcolor(X, Y, triangles, values, shading="gouraud", cmap=COLOURS, rasterized=True)
    for fraction in outlines:
        outline(
            axis, X, Y, triangles, averaged(np.stack([X, Y], axis=1), np.asarray(fraction(points)).ravel())
        )
    return image


def _draw_plane(
    axis: Any,
    mesh: Mesh,
    value: CoefficientFunction,
    section: Section,
    outlines: Sequence[CoefficientFunction],
) -> Any:
    corners = coordinates(mesh)
    low, high = corners.min(axis=0), corners.max(axis=0)
    inset = 1e-9 * (high - low)
    ranges = [np.linspace(low[i] + inset[i], high[i] - inset[i], 81) for i in section.axes]
    X, Y = np.meshgrid(*ranges)
    at = section.place(corners)
    points = np.empty((X.size, 3))
    points[:, section.axes[0]], points[:, section.axes[1]] = X.ravel(), Y.ravel()
    points[:, section.normal_axis] = np.clip(at, low + inset, high - inset)[section.normal_axis]
    found = mesh(*points.T)
    inside = found["nr"] >= 0

    def on_plane(function: CoefficientFunction) -> np.ndarray:
        values = np.full(X.size, np.nan)
        values[inside] = np.asarray(function(found[inside])).reshape(-1)
        return values.reshape(X.shape)

    image = axis.pcolormesh(X, Y, on_plane(value), shading="gouraud", cmap=COLOURS, rasterized=True)
    for share in map(on_plane, outlines):
        if has_outline(share):
            axis.contour(X, Y, share, **OUTLINE)
    return image


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
