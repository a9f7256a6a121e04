"""Diagrams as SVG, one style for all, as data URIs that a page can hold: what its pictures need of a plotter, no more.

A library takes as long to load and to draw a page as the fit takes (decision 0008). Lengths are points, 1/72 inch.
"""

from collections.abc import Callable, Sequence
from functools import partial
from html import escape
from itertools import pairwise

import numpy as np
from markupsafe import Markup
from numpy.typing import ArrayLike, NDArray

from shj_bayes._util.arrays import BoolArray, FloatArray
from shj_bayes.report.words import KN, ForceUnit

# Okabe and Ito: told apart with every common form of colour blindness, and (by lightness) in grey print.
BLUE, ORANGE, GREEN, RED, PURPLE, SKY = "#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9"
INK, GREY, PALE, NOWHERE = "#222222", "#777777", "#BBBBBB", "#D9D9D9"
SERIES = (BLUE, RED, GREEN, PURPLE, ORANGE, SKY)
# White in the middle; red and blue stay apart with every common form of colour blindness (ColorBrewer RdBu).
BLUE_TO_RED = (
    "053061",
    "2166AC",
    "4393C3",
    "92C5DE",
    "D1E5F0",
    "F7F7F7",
    "FDDBC7",
    "F4A582",
    "D6604D",
    "B2182B",
    "67001F",
)
COLOURS = 40  # of a map
WIDE, NARROW = 620.0, 353.0
LEFT, RIGHT, BOTTOM, TOP, ROW = 59.0, 12.0, 40.0, 9.0, 14.0  # margins, and a row of a key
FINE = 4  # steps of a coordinate in a point: a third of a pixel on a screen
LETTER = 0.58  # width of a letter over the size of its font
KEY_LINE, KEY_MIDDLE = np.array([0.0, 16.0]) * FINE, np.array([8.0]) * FINE  # beside the words of a key
DASHES = {"--": "20 12", ":": "5 9"}
SIGNS = {  # around a point; r is half its size and d the whole
    "o": "m-{r} 0a{r} {r} 0 1 0 {d} 0a{r} {r} 0 1 0-{d} 0z", "s": "m-{r}-{r}h{d}v{d}h-{d}z",
    "D": "m0-{d}l{d} {d}l-{d} {d}l-{d}-{d}z", "^": "m0-{r}l{r} {d}h-{d}z", "v": "m0 {r}l{r}-{d}h-{d}z",
    "<": "m-{r} 0l{d}-{r}v{d}z", ">": "m{r} 0l-{d}-{r}v{d}z",
    "x": "m-{r}-{r}l{d} {d}m0-{d}l-{d} {d}", "+": "m-{r} 0h{d}m-{r}-{r}v{d}", "_": "m-{r} 0h{d}",
}  # fmt: skip
AS_ADDRESS = {sign: f"%{ord(sign):02X}" for sign in "%#<>\"'&"}  # what an address, or the page, would read as its own
THINNINGS = 6  # turns in which points that lie on a line are left out
Draw = Callable[[FloatArray, FloatArray], str]
Range = tuple[float, float]


class Axes:
    """One diagram: what is drawn in it is kept until its limits are known."""

    def __init__(self, left: float, top: float, width: float, height: float) -> None:
        """Begin empty, at a place on the sheet."""
        self.left, self.top, self.width, self.height = left, top, width, height
        self.marks: list[tuple[FloatArray, FloatArray, Draw]] = []
        self.key: list[tuple[str, str]] = []  # words, and what is drawn beside them
        self.columns, self.size, self.grid = 1, 9.5, True  # of the key; of the numbers; fine lines at the numbers
        self.x_title = self.y_title = self.title = ""
        self.x_range: Range | None = None  # where it is none, all that is drawn and a margin
        self.y_range: Range | None = None
        self.y_factor = 1.0  # numbers that are shown over those that are drawn
        self.right: tuple[float, str] | None = None  # a second scale at the right: its factor, and its title
        self.x_numbers: int | None = None  # about as many; where it is None, what has room
        self.y_numbers: int | None = None
        self.whole = False  # only whole numbers along x
        self.rows: Sequence[str] = ()  # names of 0, 1, 2... in place of numbers along y
        self.x_words: Callable[[float], str] | None = None  # what stands at a number along x

    def plot(
        self, x: ArrayLike, y: ArrayLike, style: str = "-", *, color: str = INK, linewidth: float = 1.4,
        size: float = 4.5, hollow: bool = False, alpha: float = 1.0, label: str = "",
    ) -> None:  # fmt: skip
        """Draw a line (``-``, ``--``, ``:``), dots of half the size (``.``), marks (`SIGNS`), or both (``o-``)."""
        sign, line = style.rstrip("-:"), style.lstrip("".join((*SIGNS, ".")))
        pen, parts = _pen("stroke", color, alpha), list[tuple[Draw, FloatArray]]()
        if line:
            dashes = f' stroke-dasharray="{DASHES[line]}"' if line in DASHES else ""
            line_pen = f'{pen} stroke-width="{linewidth * FINE:.3g}"{dashes}'
            parts.append((partial(_path, pen=line_pen), KEY_LINE))
        if sign == ".":
            dot = f'{pen} stroke-width="{size * FINE / 2:.3g}" stroke-linecap="round"'
            parts.append((partial(_dots, pen=dot), KEY_MIDDLE))
        elif sign:
            drawn = f'{pen} stroke-width="{1.2 * FINE}"' if hollow or sign in "x+_" else _pen("fill", color, alpha)
            form = SIGNS[sign].format(r=f"{size * FINE / 2:.3g}", d=f"{size * FINE:.3g}")
            parts.append((partial(_signs, form=form, pen=drawn), KEY_MIDDLE))
        self.marks += [(_floats(x), _floats(y), draw) for draw, _ in parts]
        if label:
            keys = [draw(at, np.full(at.size, -3.2 * FINE)) for draw, at in parts]
            self.key.append((label, "".join(keys)))

    def fill(
        self, x: ArrayLike, low: ArrayLike, high: ArrayLike, *, color: str, alpha: float = 1.0, label: str = ""
    ) -> None:
        """Fill between two curves."""
        at, draw = _floats(x), partial(_path, pen=_pen("fill", color, alpha))
        edges = [np.broadcast_to(_floats(edge), at.shape) for edge in (low, high)]
        self.marks.append((np.append(at, at[::-1]), np.append(edges[0], edges[1][::-1]), draw))
        if label:
            ends = np.array([0.0, 16.0, 16.0, 0.0]) * FINE
            self.key.append((label, draw(ends, np.array([0.0, 0.0, -6.5, -6.5]) * FINE)))

    def across(self, y: float, style: str = "-", *, label: str = "") -> None:
        """Draw a line across the whole diagram."""
        self.plot([-np.inf, np.inf], [y, y], style, color=INK, linewidth=0.8, label=label)

    def mesh(self, x: FloatArray, y: FloatArray, values: FloatArray, reach: float) -> None:
        """Colour the fields between edges, shapes (n + 1,) and (m + 1,), by values from -reach to reach, (m, n)."""
        level = np.nan_to_num(np.round((np.clip(values / reach, -1.0, 1.0) + 1.0) / 2.0 * COLOURS), nan=-1.0)
        for one in np.unique(level):
            i, j = np.nonzero(level == one)
            gap, colour = np.full(i.size, np.nan), NOWHERE if one < 0 else _colour(one / COLOURS)
            corners = np.stack([x[j], x[j + 1], x[j + 1], x[j], gap], axis=1).ravel()
            heights = np.stack([y[i], y[i], y[i + 1], y[i + 1], gap], axis=1).ravel()
            self.marks.append((corners, heights, partial(_path, pen=f'fill="{colour}" stroke="{colour}"')))

    def limits(self) -> tuple[Range, Range]:
        """Range along x and along y."""
        out = []
        for axis, given in enumerate((self.x_range, self.y_range)):
            values = np.concatenate([np.zeros(0), *(mark[axis] for mark in self.marks)])
            seen = values[np.isfinite(values)]
            low, high = (float(seen.min()), float(seen.max())) if seen.size else (0.0, 1.0)
            room = 0.05 * (high - low) or 0.05 * abs(high) or 1.0
            out.append(given or (low - room, high + room))
        return out[0], out[1]

    def from_zero(self, high: float | None = None) -> None:
        """Let the heights begin at zero."""
        self.y_range = (0.0, self.limits()[1][1] if high is None else high)

    def svg(self) -> str:
        """Give the diagram in the coordinates of the sheet."""
        (x0, x1), (y0, y1) = self.limits()
        wide, high = self.width, self.height
        drawn, out, grid = [], [], []
        for x, y, draw in self.marks:
            at, up = (x - x0) / (x1 - x0), 1.0 - (y - y0) / (y1 - y0)
            drawn.append(draw(np.clip(at, -3, 4) * wide * FINE, np.clip(up, -3, 4) * high * FINE))
        for value, words in numbers(x0, x1, int(wide / 42) if self.x_numbers is None else self.x_numbers, self.whole):
            place = (value - x0) / (x1 - x0) * wide
            out += _text(place, high + 4 + self.size, self.x_words(value) if self.x_words else words, self.size)
            grid.append(f"M{place * FINE:.0f} 0v{high * FINE:.0f}")
        n_up = int(high / 24) if self.y_numbers is None else self.y_numbers
        rows = [(float(k), name) for k, name in enumerate(self.rows)]
        for value, words in rows or numbers(y0 * self.y_factor, y1 * self.y_factor, n_up):
            place = (1.0 - (value / self.y_factor - y0) / (y1 - y0)) * high
            out += _text(-5, place + 0.35 * self.size, words, self.size, "end")
            grid.append(f"M0 {place * FINE:.0f}h{wide * FINE:.0f}")
        if self.right:
            factor, title = self.right
            for value, words in numbers(y0 * factor, y1 * factor, n_up):
                place = (1.0 - (value / factor - y0) / (y1 - y0)) * high
                out += _text(wide + 5, place + 0.35 * self.size, words, self.size, "start")
            out += _text(wide + 44, high / 2, title, self.size + 1, turned=True)
        out += _text(wide / 2, high + 22 + self.size, self.x_title, self.size + 1)
        out += _text(-46 - 6 * self.y_title.count("\n"), high / 2, self.y_title, self.size + 1, turned=True)
        out += _text(wide, -5, self.title, 10, "end")
        lines = f'<path d="{"".join(grid)}" stroke="#000" stroke-opacity=".08" stroke-width="3"/>' if self.grid else ""
        frame = f"M0 0v{high * FINE:.0f}h{wide * FINE:.0f}" + (f"v-{high * FINE:.0f}" if self.right else "")
        return (
            f'<g transform="translate({self.left * FINE:.0f} {self.top * FINE:.0f})">'
            f'<svg width="{wide * FINE:.0f}" height="{high * FINE:.0f}">{lines}{"".join(drawn)}</svg>'
            f'<path d="{frame}" stroke="{INK}" stroke-width="3"/>{"".join(out + self._key())}</g>'
        )

    def _key(self) -> list[str]:
        """Key above the diagram, where it hides nothing, column by column."""
        rows, out, at = -(-len(self.key) // self.columns), [], 0.0
        for first in range(0, len(self.key), max(rows, 1)):
            part = self.key[first : first + rows]
            for k, (words, drawn) in enumerate(part):
                down = ROW * (k + 1 - rows) - 5.0
                out.append(f'<g transform="translate({at * FINE:.0f} {down * FINE:.0f})">{drawn}</g>')
                out += _text(at + 21, down, words, 9, "start")
            at += 33.0 + 9 * LETTER * max(len(words) for words, _ in part)
        return out


class Figure:
    """A sheet with rows of diagrams, as high as `heights` say to one another; `axes` are those of row after row."""

    def __init__(
        self, width: float, height: float, heights: Sequence[float] = (1.0,), columns: int = 1, *,
        gap: Range = (26.0, 14.0), left: float = LEFT, right: float = RIGHT, top: float = TOP, bottom: float = BOTTOM,
    ) -> None:  # fmt: skip
        """Lay the diagrams out, all of a row as wide as one another."""
        self.width, self.height, self.axes = width, height, []
        wide = (width - left - right - gap[0] * (columns - 1)) / columns
        unit = (height - top - bottom - gap[1] * (len(heights) - 1)) / sum(heights)
        for row, share in enumerate(heights):
            down = top + gap[1] * row + unit * sum(heights[:row])
            self.axes += [Axes(left + k * (wide + gap[0]), down, wide, unit * share) for k in range(columns)]


def sheet(width: float = NARROW, height: float = 252.0, *, left: float = LEFT) -> tuple[Figure, Axes]:
    """Sheet with one empty diagram."""
    figure = Figure(width, height, left=left)
    return figure, figure.axes[0]


def alike(axes: Sequence[Axes], *, x: bool = False, y: bool = False) -> None:
    """Give diagrams the same range, which holds what is in any of them."""
    along, up = zip(*(one.limits() for one in axes), strict=True)
    for one in axes:
        one.x_range = (min(a for a, _ in along), max(b for _, b in along)) if x else one.x_range
        one.y_range = (min(a for a, _ in up), max(b for _, b in up)) if y else one.y_range


def label(axes: Axes, x: str, y: str, unit: ForceUnit = KN) -> None:
    """Axis titles; they always carry a unit. Forces are drawn in kN; `unit` says what stands at the marks."""
    axes.x_title, axes.y_title = x.replace("^2", "\N{SUPERSCRIPT TWO}"), y.replace("(kN)", f"({unit.name})")
    axes.y_factor = unit.factor if "(kN)" in y else axes.y_factor


def short_name(name: str, most: int = 40) -> str:
    """Name that is not too long for a picture."""
    return name if len(name) <= most else f"{name[: most - 3]}..."


def legend(axes: Axes, columns: int = 1) -> None:
    """Put the key above the diagram, which makes room for it."""
    axes.columns, taken = columns, ROW * -(-len(axes.key) // columns)
    axes.top, axes.height = axes.top + taken, axes.height - taken


def svg(figure: Figure) -> Markup:
    """Picture as a data URI of SVG (RFC 2397); the same drawing gives the same text."""
    text = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{figure.width:g}pt" height="{figure.height:g}pt" '
        f'viewBox="0 0 {figure.width * FINE:g} {figure.height * FINE:g}" fill="none" stroke-linejoin="round">'
        f"<style>text{{fill:{INK};"
        "font-family:'DejaVu Sans',Verdana,system-ui,sans-serif}</style>"
        f"{''.join(one.svg() for one in figure.axes)}</svg>"
    )
    for sign, written in AS_ADDRESS.items():
        text = text.replace(sign, written)
    return Markup(f"data:image/svg+xml,{text}")  # it holds nothing that a page would escape


def drawn(figure: Figure, x: str, y: str, columns: int = 1, unit: ForceUnit = KN) -> Markup:
    """Picture of a sheet with one diagram, which gets its titles, and its key in so many columns."""
    label(figure.axes[0], x, y, unit)
    legend(figure.axes[0], columns)
    return svg(figure)


def numbers(low: float, high: float, most: int, whole: bool = False) -> list[tuple[float, str]]:
    """As many round numbers of a range as there may be, each with how it is written."""
    if most < 1 or not high > low:
        return []
    tens = 10.0 ** np.floor(np.log10((high - low) / (most + 1)))
    for step in (tens * k for k in (1.0, 2.0, 2.5, 5.0, 10.0, 20.0, 25.0, 50.0, 100.0)):
        values = step * np.arange(np.ceil(low / step - 1e-9), np.floor(high / step + 1e-9) + 1)
        if values.size <= most and not (whole and step % 1):
            break
    places = next(p for p in range(20) if abs(step * 10**p - round(step * 10**p)) < 1e-6 * step * 10**p)
    shown = [f"{value:.{places}f}" if places < 6 and step < 1e6 else f"{value:.5g}" for value in values + 0.0]
    return list(zip(values.tolist(), (one.replace("-", "\N{MINUS SIGN}") for one in shown), strict=True))


def _floats(values: ArrayLike) -> FloatArray:
    return np.atleast_1d(np.asarray(values, dtype=np.float64))


def _pen(what: str, color: str, alpha: float) -> str:
    return f'{what}="{color}"' + (f' {what}-opacity="{alpha:g}"' if alpha < 1 else "")


def _colour(place: float) -> str:
    """Colour between blue (0) and red (1)."""
    table = np.array([list(bytes.fromhex(one)) for one in BLUE_TO_RED])
    mixed = (np.interp(place, np.linspace(0, 1, len(table)), column) for column in table.T)
    return "#" + "".join(f"{round(part):02X}" for part in mixed)


def _text(x: float, y: float, words: str, size: float, side: str = "middle", *, turned: bool = False) -> list[str]:
    """Lines of text below one another."""
    out = []
    for k, line in enumerate(words.split("\n") if words else ()):
        right, down = (x + 1.25 * size * k, y) if turned else (x, y + 1.25 * size * k)
        place = f"{right * FINE:.0f} {down * FINE:.0f}"
        turn = " rotate(-90)" if turned else ""
        how = f'transform="translate({place}){turn}" font-size="{size * FINE:g}" text-anchor="{side}"'
        out.append(f"<text {how}>{escape(line)}</text>")
    return out


def _points(x: FloatArray, y: FloatArray) -> tuple[NDArray[np.complex128], BoolArray]:
    """Points as whole numbers, x + iy, without those that are none; and which of them come behind such."""
    there = np.isfinite(x + y)
    behind = there.copy()
    behind[1:] &= ~there[:-1]
    return np.round(x[there]) + 1j * np.round(y[there]), behind[there]


def _moves(points: NDArray[np.complex128]) -> list[str]:
    """How far each point lies from the one before it, right and down, as text."""
    return list(map(str, np.diff(points, prepend=0).view(np.float64).astype(np.int64).tolist()))


def _path(x: FloatArray, y: FloatArray, pen: str) -> str:
    """Line, or edge of an area, through points; a new one begins where some are not numbers.

    Points that lie, to within half a step, on the line between their neighbours are left out, every second one at a
    time, so that the neighbours of one that goes stay.
    """
    at, begins = _points(x, y)
    stays = begins.copy()
    stays[:-1] |= begins[1:]
    for turn in range(THINNINGS):
        first = turn % 2
        middle = at[first + 1 : -1 : 2]
        before, after = middle - at[first:-2:2], at[first + 2 :: 2] - middle
        turned = before.conj() * after  # along, and across
        level = (np.abs(turned.imag) <= 0.5 * np.abs(before + after)) & (turned.real >= 0)
        keep = np.ones(at.size, dtype=bool)
        keep[first + 1 : -1 : 2] = ~level | stays[first + 1 : -1 : 2]
        at, begins, stays = at[keep], begins[keep], stays[keep]
    pieces, moves = [*np.flatnonzero(begins).tolist(), at.size], _moves(at)
    text = [
        f"M{at[a].real:.0f} {at[a].imag:.0f}l{' '.join(moves[2 * a + 2 : 2 * b]) or '0 0'}" for a, b in pairwise(pieces)
    ]
    return f'<path d="{"".join(text).replace(" -", "-")}" {pen}/>' if text else ""


def _dots(x: FloatArray, y: FloatArray, pen: str) -> str:
    """Round dots in one path, from left to right; two in one place look like one."""
    moves = _moves(np.unique(_points(x, y)[0]))
    text = "".join(f"m{a} {b}h0" for a, b in zip(moves[::2], moves[1::2], strict=True))
    return f'<path d="{text.replace(" -", "-")}" {pen}/>' if text else ""


def _signs(x: FloatArray, y: FloatArray, form: str, pen: str) -> str:
    """Draw marks of a form in one path."""
    there = np.isfinite(x + y)
    parts = [f"M{a:.0f} {b:.0f}{form}" for a, b in zip(x[there], y[there], strict=True)]
    return f'<path d="{"".join(parts)}" {pen}/>' if parts else ""
