"""Where the axes of a figure stand: one above the other, with room for what is round each of them."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.backend_bases import RendererBase
    from matplotlib.figure import Figure
    from matplotlib.transforms import Bbox

PAD = 0.042  # inches round all that belongs to axes
LABEL_GAP = 4.0  # points between the numbers of an axis and its name


def lay_out(figure: Figure, renderer: RendererBase) -> None:
    """Axes one above the other, of one height and width, as large as what stands round them leaves room for.

    Each text is measured once: matplotlib's own constrained layout measures all of them six times.
    """
    width, height = figure.bbox.size
    pad, gap = PAD * figure.dpi, LABEL_GAP * figure.dpi / 72
    sides = [_round(ax, renderer) for ax in figure.axes]
    labels = [_label_sizes(ax, renderer) for ax in figure.axes]
    ticks = max(one.left for one in sides)  # the labels of all axes stand in one line
    left = pad + max(ticks + max(gap + wide if wide else 0.0 for wide, _ in labels), *(one.over for one in sides))
    right = pad + max(one.right for one in sides)
    tops = [one.top for one in sides]
    bottoms = [one.bottom + (gap + high if high else 0.0) for one, (_, high) in zip(sides, labels, strict=True)]
    inner_width = max(width - left - right, width / 10)
    inner_height = (height - sum(tops) - sum(bottoms) - 2 * pad * len(sides)) / len(sides)
    inner_height = max(inner_height, height / (10 * len(sides)))
    upper = height
    for ax, side, top, bottom in zip(figure.axes, sides, tops, bottoms, strict=True):
        lower = upper - pad - top - inner_height
        ax.set_position((left / width, lower / height, inner_width / width, inner_height / height))
        ax.yaxis.set_label_coords(-(ticks + gap) / inner_width, 0.5)
        ax.xaxis.set_label_coords(0.5, -(side.bottom + gap) / inner_height)
        upper = lower - bottom - pad


@dataclass(frozen=True)
class _Sides:
    """Pixels by which what belongs to axes stands out, without the names of the quantities; left: ticks with their
    numbers alone, over: all on that side."""

    left: float
    over: float
    right: float
    top: float
    bottom: float


def _round(ax: Axes, renderer: RendererBase) -> _Sides:
    inner, boxes = ax.bbox, []
    for axis in (ax.xaxis, ax.yaxis):
        axis.set_label_coords(0.5, 0.5)  # given by us, so that matplotlib looks for no place
        axis.label.set_visible(False)
        boxes.append(axis.get_tightbbox(renderer))
        axis.label.set_visible(True)
    left = _beyond(inner, boxes[1:])[0]
    legend = ax.get_legend()
    boxes += [] if legend is None else [legend.get_window_extent(renderer)]
    boxes += [text.get_window_extent(renderer) for text in ax.texts]
    return _Sides(left, *_beyond(inner, boxes))


def _beyond(inner: Bbox, boxes: Iterable[Bbox | None]) -> tuple[float, float, float, float]:
    """How far the furthest of the boxes reaches beyond the inner one: left, right, above, below."""
    met = [inner, *(box for box in boxes if box is not None)]
    return (
        max(inner.x0 - box.x0 for box in met), max(box.x1 - inner.x1 for box in met),
        max(box.y1 - inner.y1 for box in met), max(inner.y0 - box.y0 for box in met),
    )  # fmt: skip


def _label_sizes(ax: Axes, renderer: RendererBase) -> tuple[float, float]:
    """Pixels from left to right of the name beside the axes, and from top to bottom of the one below; 0 without."""
    beside, below = ax.yaxis.label, ax.xaxis.label
    return (
        beside.get_window_extent(renderer).width if beside.get_text() else 0.0,
        below.get_window_extent(renderer).height if below.get_text() else 0.0,
    )
