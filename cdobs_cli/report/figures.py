"""Drawing: charts and ladders to SVG, PNG or PDF. The only module that loads matplotlib.

Pictures are deterministic: no dates, fixed identifiers, text as paths of fonts that come with matplotlib. They are as
wide as a column, with text that can be read on a phone; lines differ in dashes, not in colours alone.
"""

from __future__ import annotations

import io
import math
import re
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.report.ladder import Ladder
from cdobs_cli.report.layout import lay_out
from cdobs_cli.report.palette import (
    BLACK,
    BLUE,
    GREEN,
    GREY,
    GRID,
    ORANGE,
    PALE,
    PURPLE,
    SKY,
    STRETCHED,
    VERMILLION,
    WHITE,
)
from cdobs_cli.report.prose import mathtext

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

ROLE_COLOURS = {
    "truth": BLACK, "estimate": BLUE, "proved": GREEN, "refuted": VERMILLION, "measured": ORANGE, "arrived": ORANGE,
    "beside": VERMILLION,
}  # fmt: skip
OTHER_COLOURS = (PURPLE, SKY, ORANGE, GREY, BLUE, GREEN)
SENSOR_COLOURS = (ORANGE, PURPLE, SKY, GREEN, GREY)
# The first line of a role, then the further ones: dashes keep them apart where colours cannot.
ROLE_DASHES: dict[str, Any] = {"estimate": (0, (5, 1.6)), "proved": (0, (6, 1.5, 1, 1.5)), "refuted": (0, (3, 1.2))}
FURTHER_DASHES: tuple[Any, ...] = ("-", (0, (4, 1.5)), (0, (1, 1.2)), (0, (6, 1.5, 1, 1.5)), (0, (8, 2)))
MARKERS = ("o", "s", "^", "D", "v")
_HATCHED: dict[str, Any] = {"facecolor": PALE, "edgecolor": VERMILLION, "hatch": "////", "linewidth": 0.6}
WIDTH = 4.8  # inches: of a phone's 358 pixels each point takes one
HEIGHTS = {1: 2.5, 2: 1.75, 3: 1.5}  # inches of a panel, by their number
LOW = 1.4
LETTER = 0.075  # inches of one, roughly
LEGEND_WIDTH = 300  # points
SHARE = 0.45  # of the width, of the part of an axis that is stretched
WIDE = 10.0  # ratio of the values of a map from which on their colours are logarithmic
MANY_POINTS = 40  # more are drawn small
LARGEST = 1e150  # values beyond are not drawn: axes overflow
_STYLE: Any = {
    "font.family": "STIXGeneral", "mathtext.fontset": "stix", "font.size": 11, "axes.linewidth": 0.7,
    "axes.spines.top": False, "axes.spines.right": False, "axes.grid": True, "grid.color": GRID,
    "grid.linewidth": 0.5, "axes.axisbelow": True, "xtick.major.width": 0.7, "ytick.major.width": 0.7,
    "legend.frameon": False, "legend.fontsize": 10.8, "lines.solid_capstyle": "round", "svg.fonttype": "path",
    "svg.hashsalt": "cdobs", "svg.image_inline": True, "hatch.linewidth": 0.6, "path.simplify": True,
    "axes.unicode_minus": True, "axes.xmargin": 0.015, "axes.labelsize": 11, "xtick.labelsize": 10.8,
    "ytick.labelsize": 10.8, "axes.formatter.useoffset": False,
}  # fmt: skip


def draw(chart: Chart | Ladder, formats: Sequence[str] = ("svg",)) -> dict[str, bytes]:
    """The chart in each of the formats (svg, png, pdf), by format; laid out once."""
    import matplotlib as mpl

    _load()
    with mpl.rc_context(_STYLE):
        figure = _ladder_figure(chart) if isinstance(chart, Ladder) else _chart_figure(chart)
        # SVG first: it lays out, and where everything stands is the same in every format.
        svg = _svg(figure)
        return {one: svg if one == "svg" else _PRINTED[one](figure) for one in formats}


def _load() -> None:
    """Matplotlib, without the documentation of its artists: writing it takes a third of the time to load."""
    if "matplotlib.figure" in sys.modules:
        return
    with _undocumented() if not hasattr(sys, "ps1") else nullcontext():  # nobody asks for help but in a session
        import matplotlib.backends.backend_svg
        import matplotlib.figure  # noqa: F401


@contextmanager
def _undocumented() -> Iterator[None]:
    from matplotlib import artist

    write, of_class = artist.kwdoc, "_update_set_signature_and_docstring"
    kept = artist.Artist.__dict__.get(of_class)
    artist.kwdoc = lambda artist: ""
    if kept is not None:
        setattr(artist.Artist, of_class, classmethod(lambda cls: None))
    try:
        yield
    finally:
        artist.kwdoc = write
        if kept is not None:
            setattr(artist.Artist, of_class, kept)


def _svg(figure: Figure) -> bytes:
    from matplotlib.backends import backend_svg
    from matplotlib.textpath import text_to_path

    figure.set_dpi(72)
    width, height = 72 * figure.get_size_inches()
    content = io.StringIO()
    metadata = {"Date": None, "Creator": None}
    renderer: Any = backend_svg.RendererSVG(width, height, content, image_dpi=72, metadata=metadata)  # type: ignore[no-untyped-call]
    renderer._text2path = text_to_path  # that of all figures: what was read of a label is known there
    if figure.get_layout_engine() is None:
        lay_out(figure, renderer)
    figure.draw(renderer)
    figure.set_layout_engine("none")
    renderer.finalize()
    return content.getvalue().encode()


def _png(figure: Figure) -> bytes:
    from matplotlib.backends.backend_agg import FigureCanvasAgg

    figure.set_dpi(200)
    return _printed(FigureCanvasAgg(figure).print_png, {"Software": None})


def _pdf(figure: Figure) -> bytes:
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    return _printed(FigureCanvasPdf(figure).print_pdf, {"CreationDate": None, "Creator": None, "Producer": None})


def _printed(print_to: Callable[..., Any], metadata: Mapping[str, None]) -> bytes:
    content = io.BytesIO()
    print_to(content, metadata=metadata)
    return content.getvalue()


_PRINTED: Mapping[str, Callable[[Figure], bytes]] = {"png": _png, "pdf": _pdf}


# ---------------------------------------------------------------- charts


def _chart_figure(chart: Chart) -> Figure:
    from matplotlib.figure import Figure

    count = max(1, len(chart.panels))
    is_map = any(series.kind == "cells" for panel in chart.panels for series in panel.series)
    height = HEIGHTS[1] if is_map else HEIGHTS.get(count, LOW)
    # A map has a scale of colours beside each panel, for which matplotlib's own layout finds the place.
    figure = Figure(figsize=(WIDTH, 0.6 + count * height), layout="constrained" if is_map else None)
    axes = figure.subplots(count, 1, sharex=len({panel.x_scale for panel in chart.panels}) <= 1, squeeze=False)[:, 0]
    known: set[str] = set()
    for index, (ax, panel) in enumerate(zip(axes, chart.panels, strict=False)):
        _draw_panel(ax, panel, known)
        if index == count - 1 or panel.x_label != chart.panels[-1].x_label:
            ax.set_xlabel(_mathematics(panel.x_label))
    if chart.stretch is not None:
        _stretch(list(axes), chart.stretch)
    for ax, panel in zip(axes, chart.panels, strict=False):
        _tidy(ax.yaxis, panel.y_label)
        ax.set_ylabel(_wrapped(ax.get_ylabel(), height))
        if chart.stretch is None and ax is axes[-1]:
            _tidy(ax.xaxis, panel.x_label)
    if is_map:
        figure.align_ylabels(list(axes))
    return figure


def _draw_panel(ax: Axes, panel: Panel, known: set[str]) -> None:
    seen: dict[str, int] = {}
    many = len(panel.series) > 8
    for series in panel.series:
        index = seen.get(series.role, 0)
        seen[series.role] = index + 1
        _draw_series(ax, series, index, many=many, panel=panel)
    ax.set_ylabel(_mathematics(panel.y_label))
    if panel.x_scale == "log":
        ax.set_xscale("log")
        _plain_ticks(ax.xaxis, ax.get_xlim())
    if panel.y_scale == "log" and _has_positive(panel):
        ax.set_yscale("log")
    if panel.y_range is not None:
        low, high = panel.y_range
        ax.set_ylim(low if math.isfinite(low) else None, high if math.isfinite(high) else None)
    if panel.y_scale == "log" and _has_positive(panel):
        _plain_ticks(ax.yaxis, ax.get_ylim())
    _legend(ax, known)


def _wrapped(label: str, height: float) -> str:
    """The label of a panel so many inches high, its unit on a line of its own where it is long."""
    letters = len(re.sub(r"\\[a-z]+|[${}]", "", label))
    return label.replace(" (", "\n(") if LETTER * letters > height - 0.2 else label


def _stretch(axes: Sequence[Axes], end: float) -> None:
    """The axis that all share, up to `end` on a larger scale, with a ground of its own."""
    from matplotlib.scale import FuncScale
    from matplotlib.ticker import FixedFormatter, FixedLocator, MaxNLocator, NullLocator

    first, last = axes[0].get_xlim()
    points, places = np.array([0.0, end, last]), np.array([0.0, SHARE, 1.0])
    before, after = (places[1:] - places[:-1]) / (points[1:] - points[:-1])

    def forward(x: Any) -> Any:
        x = np.asarray(x, dtype=float)
        return np.where(x < end, x * before, SHARE + (x - end) * after)

    def back(y: Any) -> Any:
        y = np.asarray(y, dtype=float)
        return np.where(y < SHARE, y / before, end + (y - SHARE) / after)

    axes[0].set_xscale(FuncScale(axes[0].xaxis, (forward, back)))
    axes[0].set_xlim(max(first, -0.03 * end), last)
    near, gap = [0.0, end / 2, end], 0.08 / after
    far = [one for one in MaxNLocator(4).tick_values(0.0, last) if end + gap < one <= last]
    ticks = [*near, *far]
    axes[0].xaxis.set_major_locator(FixedLocator(ticks))
    axes[0].xaxis.set_major_formatter(FixedFormatter([f"{one:.6g}" for one in ticks]))
    axes[0].xaxis.set_minor_locator(NullLocator())
    for ax in axes:
        ax.axvspan(axes[0].get_xlim()[0], end, facecolor=STRETCHED, edgecolor="none", zorder=-1)


def _tidy(axis: Axis, label: str) -> None:
    """Few ticks, and very large and small numbers with their power of ten at the label, where no legend is."""
    from matplotlib.ticker import FuncFormatter, MaxNLocator

    if axis.get_scale() != "linear":
        return
    axis.set_major_locator(MaxNLocator(5, steps=[1, 2, 2.5, 5, 10]))
    largest = max(map(abs, axis.get_view_interval()))
    exponent = math.floor(math.log10(largest)) if 0 < largest < math.inf else 0
    if not -3 <= exponent < 4:
        power = rf"$10^{{{exponent}}}$"
        axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value / 10.0**exponent:.6g}"))
        head, bracket, unit = label.rpartition(" (")
        told = f"{head} ({power} {unit}" if bracket and unit.endswith(")") else f"{label} ({power})"
        axis.set_label_text(_mathematics(told))


def _plain_ticks(axis: Axis, ends: tuple[float, float]) -> None:
    """Numbers like 0.5 and 2 on a logarithmic axis of few decades; powers of ten are left to wide ones."""
    low, high = ends
    if low <= 0 or high > 1000 * low or high > 1e4 or low < 1e-4:
        return
    digits = (1, 2, 5) if high > 12 * low else (1, 2, 3, 4, 5, 6, 8)

    def label(value: float, _position: float) -> str:
        lead = value / 10 ** math.floor(math.log10(value) + 1e-9)
        return f"{value:g}" if any(abs(lead - digit) < 1e-6 for digit in digits) else ""

    axis.set_major_formatter(label)
    axis.set_minor_formatter(label)


def _has_positive(panel: Panel) -> bool:
    return any(float(value) > 0 for series in panel.series if series.kind != "mark" for value in series.y)


def _legend(ax: Axes, known: set[str]) -> None:
    """Above the axes, each label once in a figure; many runs of one kind count as one."""
    handles, labels = ax.get_legend_handles_labels()
    fresh: dict[str, Any] = {}
    for handle, label in zip(handles, labels, strict=True):
        short = label.partition(", run ")[0]
        if short not in known:
            fresh.setdefault(short, handle)
    known |= set(fresh)
    if fresh:
        # Points, roughly: a legend wider than the axes would squeeze them.
        widths = [5.3 * len(re.sub(r"[\\${}]|mathrm", "", label)) + 36 for label in fresh]
        columns = len(fresh) if sum(widths) < LEGEND_WIDTH else max(1, int(LEGEND_WIDTH / max(widths)))
        ax.legend(list(fresh.values()), list(fresh), loc="lower left", bbox_to_anchor=(0, 1.0), ncols=columns,
                  borderaxespad=0.15, handlelength=1.9, columnspacing=1.1, handletextpad=0.5)  # fmt: skip


def _draw_series(ax: Axes, series: Series, index: int, *, many: bool, panel: Panel) -> None:
    colour = ROLE_COLOURS.get(series.role) or OTHER_COLOURS[index % len(OTHER_COLOURS)]
    if series.role == "measured":
        colour = SENSOR_COLOURS[series.place % len(SENSOR_COLOURS)]
    # An estimate is dashed to show the truth below it; without it, or alone, a full line is easier to read.
    lines = {other.role for other in panel.series if other.role == "truth" or other.kind != "points"}
    below = bool(lines & {"truth", "measured"})
    alone = len(panel.series) == 1 or (series.role == "estimate" and not below)
    first = "-" if alone else ROLE_DASHES.get(series.role, "-")
    dashes = first if index == 0 or many else FURTHER_DASHES[index % len(FURTHER_DASHES)]
    label = _mathematics(series.label)
    x = _drawable(series.x)
    y = _drawable(series.y, positive=panel.y_scale == "log")
    width = 0.7 if series.role == "beside" or (many and index) else 1.5
    line: dict[str, Any] = {"color": colour, "linestyle": "-" if many else dashes, "linewidth": width, "label": label}
    match series.kind:
        case "line":
            ax.plot(x, y, **line, alpha=0.6 if many and series.role != "proved" else 1.0)
        case "steps":
            ax.step(x, y, where="post", **line)
        case "points":
            marker = MARKERS[(series.place or index) % len(MARKERS)]
            size, edge, rim = (4.2, 0.5, WHITE) if len(x) <= MANY_POINTS else (3.0, 0.4, WHITE)
            if series.role in ("refuted", "arrived"):  # what is not there, or not at its stamp
                marker, edge, rim = "x", 0.9, colour
            ax.plot(x, y, linestyle="none", marker=marker, markersize=size, color=colour, markeredgecolor=rim,
                    markeredgewidth=edge, label=label, zorder=4)  # fmt: skip
        case "stems":
            ax.vlines(x, 0, y, color=colour, linewidth=1.0, alpha=0.8)
            ax.plot(x, y, linestyle="none", marker="o", markersize=3, color=colour, label=label)
        case "band":
            y2 = _drawable(series.y2, positive=panel.y_scale == "log")
            ax.fill_between(x, y, y2, color=colour, alpha=0.18, linewidth=0, label=label)
            for end in (y, y2):
                ax.plot(x, end, color=colour, linewidth=0.8)
        case "cells":
            _draw_cells(ax, x, y, _drawable(series.y2), label)
        case "limit":
            for value in y[:1][np.isfinite(y[:1])]:
                ax.axhline(value, **line)
        case "mark":
            for value in x[:1][np.isfinite(x[:1])]:
                ax.axvline(value, **(line | {"linewidth": 1.1}))


def _draw_cells(ax: Axes, x: Any, y: Any, values: Any, label: str) -> None:
    """A coloured cell for each point that has a value, halfway to its neighbours, and the scale of colours."""
    columns, rows = np.unique(x[np.isfinite(x)]), np.unique(y[np.isfinite(y)])
    shades = np.full((len(rows), len(columns)), np.nan)
    for place, row, value in zip(x, y, values, strict=True):
        if np.isfinite(place) and np.isfinite(row):
            shades[np.searchsorted(rows, row), np.searchsorted(columns, place)] = value
    ax.grid(visible=False)
    if np.isfinite(shades).any():
        low, high = np.nanmin(shades), np.nanmax(shades)
        norm = "log" if low > 0 and high > WIDE * low else "linear"
        cells = np.ma.masked_invalid(shades)
        mesh = ax.pcolormesh(_edges(columns), _edges(rows), cells, cmap="cividis", norm=norm)
        solids = ax.figure.colorbar(mesh, ax=ax, label=label).solids
        if solids is not None:
            solids.set_edgecolor("face")  # no seams


def _edges(centres: Any) -> Any:
    """Halfway between neighbours; the outer cells are as wide as they are on their inner side."""
    if len(centres) == 1:
        half = 0.5 * abs(centres[0]) or 0.5
        return np.array([centres[0] - half, centres[0] + half])
    middle = (centres[1:] + centres[:-1]) / 2
    return np.concatenate([[max(2 * centres[0] - middle[0], centres[0] / 2 if centres[0] > 0 else -np.inf)], middle,
                           [2 * centres[-1] - middle[-1]]])  # fmt: skip


def _drawable(values: Any, *, positive: bool = False) -> Any:
    """Floats with what an axis cannot show replaced by gaps."""
    array = np.array(values, dtype=float)
    with np.errstate(invalid="ignore"):
        shown = np.isfinite(array) & (np.abs(array) < LARGEST) & ((array > 0) if positive else True)
    return np.where(shown, array, np.nan)


@lru_cache(256)
def _mathematics(text: str) -> str:
    """The text with its names set, and its `$..$` where they can be; with plain dollars where not."""
    from matplotlib.font_manager import FontProperties
    from matplotlib.textpath import text_to_path

    told = mathtext(text)
    if "$" not in told:
        return told
    try:
        if told.replace(r"\$", "").count("$") % 2 == 0:
            # As it is drawn, so that it is read once.
            drawn = FontProperties(size=text_to_path.FONT_SCALE)
            text_to_path.mathtext_parser.parse(told, text_to_path.DPI, drawn)
            return told
    except ValueError:
        pass
    return text.replace("$", r"\$")


# ---------------------------------------------------------------- ladders


def _ladder_figure(ladder: Ladder) -> Figure:
    from matplotlib.figure import Figure

    count = len(ladder.rungs)
    figure = Figure(figsize=(WIDTH, 0.95 + 0.5 * count))
    ax = figure.subplots()
    every = [end for rung in ladder.rungs for end in (rung.proved, rung.refuted)]
    ends = [end for end in every if end is not None and math.isfinite(end) and end > 0]
    largest, smallest = max(ends, default=1.0), min(ends, default=1.0)
    logarithmic = largest > 40 * smallest
    left, right = (smallest / 3, largest * 2) if logarithmic else (0.0, largest * 1.15)
    for row, rung in enumerate(ladder.rungs):
        y = count - 1 - row
        if rung.proved is not None and rung.proved > 0:
            ax.barh(y - 0.2, min(rung.proved, right) - left, left=left, height=0.34, linewidth=0.6, color=GREEN,
                    edgecolor=GREEN)  # fmt: skip
        if rung.refuted is not None and rung.refuted < right:
            start = max(rung.refuted, left)
            ax.barh(y - 0.2, right - start, left=start, height=0.34, **_HATCHED)
        ax.text(0.008, y + 0.22, _mathematics(f"{rung.label}: {rung.text}"), transform=ax.get_yaxis_transform(),
                va="center")  # fmt: skip
    if logarithmic:
        ax.set_xscale("log")
        _plain_ticks(ax.xaxis, (left, right))
    ax.set_xlim(left, right)
    ax.set_ylim(-0.6, count - 0.4)
    ax.set_yticks([])
    ax.grid(visible=False, axis="y")
    ax.set_xlabel(_mathematics(ladder.x_label))
    _tidy(ax.xaxis, ladder.x_label)
    _ladder_legend(ax, ladder)
    return figure


def _ladder_legend(ax: Axes, ladder: Ladder) -> None:
    from matplotlib.patches import Patch

    handles = []
    if any(rung.proved is not None for rung in ladder.rungs):
        handles.append(Patch(facecolor=GREEN, label="proved"))
    if any(rung.refuted is not None for rung in ladder.rungs):
        handles.append(Patch(**_HATCHED, label="refuted"))
    ax.legend(handles=handles, loc="lower left", bbox_to_anchor=(0, 1.0), ncols=2, borderaxespad=0.15)
