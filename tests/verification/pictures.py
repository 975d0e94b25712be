"""Plots as PNG, by matplotlib."""

import io
from typing import Any

import numpy as np

from ngvisco.run.plots import figure
from tests.verification.case import Plot


def draw(plot: Plot) -> bytes:
    """The picture as PNG; raises PlotError without matplotlib."""
    fig, ((axis,),) = figure(1, 1, (6.4, 4.2))
    for curve in plot.curves:
        x, y = np.asarray(curve.x, dtype=float), np.asarray(curve.y, dtype=float)
        if "y" in plot.log:
            y = np.where(y > 0, y, np.nan)
        axis.plot(x, y, curve.style, label=curve.label, ms=4, lw=1.3)
    if "x" in plot.log:
        axis.set_xscale("log")
    if "y" in plot.log:
        axis.set_yscale("log")
    axis.set(title=plot.title, xlabel=plot.xlabel, ylabel=plot.ylabel)
    axis.grid(alpha=0.3)
    if any(curve.label for curve in plot.curves):
        if len(plot.curves) > 6:  # beside the axes: it would hide half of them
            axis.legend(fontsize="x-small", loc="center left", bbox_to_anchor=(1.0, 0.5))
        else:
            axis.legend(fontsize="small")
    return _as_png(fig)


def _as_png(fig: Any) -> bytes:
    """With a palette of 64 colours: a third of the size, and a report has a hundred of them."""
    from PIL import Image  # matplotlib needs Pillow

    drawn, small = io.BytesIO(), io.BytesIO()
    fig.savefig(drawn, dpi=90, format="png")
    Image.open(drawn).convert("RGB").quantize(64).save(small, format="png", optimize=True)
    return small.getvalue()
