"""Sheets to draw on, one style for all, and pictures as data URIs that a page can hold."""

import base64
from io import BytesIO

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter

from shj_bayes.report.force_unit import KN, ForceUnit

# Okabe and Ito: told apart with every common form of colour blindness, and (by lightness) in grey print.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, GREY, PALE = "#222222", "#777777", "#BBBBBB"
SERIES = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
WIDE, NARROW = 8.6, 4.9
LEFT, RIGHT, BOTTOM, TOP, ROW = 0.82, 0.16, 0.56, 0.12, 0.19  # inches: fixed margins, and a row of a key
DPI = 125  # of what is dense and therefore drawn in pixels


def sheet(width: float = NARROW, height: float = 3.5, *, measured: bool = True) -> tuple[Figure, Axes]:
    """One empty diagram, size in inches; without `measured` its margins are those of `fixed`."""
    figure = Figure(figsize=(width, height), layout="constrained") if measured else fixed(width, height)
    return figure, tidy(figure.add_subplot())


def fixed(width: float, height: float, *, left: float = LEFT, top: float = TOP, right: float = RIGHT) -> Figure:
    """Empty sheet with margins in inches; to measure what stands in them takes as long as to draw it."""
    figure = Figure(figsize=(width, height))
    edges = {"left": left / width, "right": 1 - right / width, "bottom": BOTTOM / height, "top": 1 - top / height}
    figure.subplots_adjust(**edges)
    return figure


def tidy(axes: Axes) -> Axes:
    """House style of one diagram."""
    axes.spines[["top", "right"]].set_visible(False)
    axes.grid(visible=True, color="#000000", alpha=0.08, linewidth=0.8)
    axes.set_axisbelow(True)
    axes.tick_params(labelsize=9.5, colors=INK)
    return axes


def label(axes: Axes, x: str, y: str, unit: ForceUnit = KN) -> None:
    """Axis titles; they always carry a unit. Forces are drawn in kN; `unit` says what stands at the marks."""
    axes.set_xlabel(x.replace("^2", "\N{SUPERSCRIPT TWO}"), fontsize=10.5, color=INK)
    axes.set_ylabel(y.replace("(kN)", f"({unit.name})"), fontsize=10.5, color=INK)
    if "(kN)" in y and unit.factor != 1:
        axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value * unit.factor:g}"))


def plain(name: str, most: int = 40) -> str:
    """Signs that matplotlib would read as mathematics made plain, and not too long."""
    return (name if len(name) <= most else name[: most - 3] + "...").replace("$", r"\$")


def legend(axes: Axes, columns: int = 1) -> None:
    """Key above the diagram, where it hides nothing; the highest diagram of a sheet of fixed margins makes room."""
    figure, place = axes.get_figure(root=True), axes.get_subplotspec()
    if figure and place and figure.get_layout_engine() is None and place.rowspan.start == 0:
        rows = -(-len(axes.get_legend_handles_labels()[1]) // columns)
        figure.subplots_adjust(top=1 - (TOP + ROW * rows) / figure.get_size_inches()[1])
    axes.legend(
        loc="lower left",
        bbox_to_anchor=(-0.02, 1.0),
        ncols=columns,
        frameon=False,
        fontsize=9,
        handlelength=1.6,
        borderaxespad=0.1,
        columnspacing=1.2,
    )


def _lay_out(figure: Figure) -> None:
    """Place the diagrams once; saving a figure that has an engine for it draws everything twice."""
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
        figure.set_layout_engine(None)


def svg(figure: Figure) -> str:
    """Picture as a data URI of SVG; the same drawing gives the same text."""
    with mpl.rc_context({"svg.hashsalt": "shj-bayes", "svg.fonttype": "path"}):
        content = _drawn(figure, "svg", DPI, {"Date": None, "Creator": None})
    return _data_uri("svg+xml", content)


def png(figure: Figure, dpi: int = DPI) -> str:
    """Picture as a data URI of PNG, for drawings of very many elements."""
    return _data_uri("png", _drawn(figure, "png", dpi, {"Software": None}))


def _drawn(figure: Figure, kind: str, dpi: int, metadata: dict[str, str | None]) -> bytes:
    buffer = BytesIO()
    _lay_out(figure)
    figure.savefig(buffer, format=kind, transparent=True, dpi=dpi, metadata=metadata)
    return buffer.getvalue()


def _data_uri(kind: str, content: bytes) -> str:
    """Content of an image of a MIME type below ``image/`` as a data URI (RFC 2397)."""
    return f"data:image/{kind};base64,{base64.b64encode(content).decode('ascii')}"
