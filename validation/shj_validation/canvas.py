"""Sheets for the pictures of a proof and of the documents: matplotlib, in the colours of the pages."""

import base64
from io import BytesIO

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from shj_bayes.report.figures.canvas import INK

WIDE, NARROW = 8.6, 4.9  # inches


def sheet(width: float = NARROW, height: float = 3.5) -> tuple[Figure, Axes]:
    """One empty diagram, size in inches."""
    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, tidy(figure.add_subplot())


def tidy(axes: Axes) -> Axes:
    """House style of one diagram."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(visible=True, color="#000000", alpha=0.08, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9.5, colors=INK)
    return axes


def label(axes: Axes, x: str, y: str) -> None:
    """Axis titles; they always carry a unit."""
    axes.set_xlabel(x, fontsize=10.5, color=INK)
    axes.set_ylabel(y, fontsize=10.5, color=INK)


def legend(axes: Axes, columns: int = 1) -> None:
    """Key above the diagram, where it hides nothing."""
    axes.legend(loc="lower left", bbox_to_anchor=(-0.02, 1.0), ncols=columns, frameon=False, fontsize=9)


def svg(figure: Figure) -> str:
    """Picture as a data URI of SVG; the same drawing gives the same text."""
    buffer = BytesIO()
    with mpl.rc_context({"svg.hashsalt": "shj-bayes", "svg.fonttype": "path"}):
        figure.savefig(buffer, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    return f"data:image/svg+xml;base64,{base64.b64encode(buffer.getvalue()).decode('ascii')}"
