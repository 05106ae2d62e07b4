"""The small picture of the index: the first curves of a figure, with the ends of its axes, as a drawing of its own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from html import escape

from cdobs_cli.chart import Chart, Panel, Series
from cdobs_cli.report.numbers import number_text
from cdobs_cli.report.palette import BLACK, BLUE, GREEN, GREY, PURPLE, VERMILLION, adaptable, variables

NAME = "thumbnail"
_ORDER = ("error", "bands", "width", "states", "typed_states")  # of the figures, the most telling first
_COLOURS = {"truth": BLACK, "estimate": BLUE, "proved": GREEN, "refuted": VERMILLION, "beside": GREY}
_WIDTH, _HEIGHT = 176, 92  # pixels, as it is shown
_LEFT, _RIGHT, _TOP, _BOTTOM = 4.0, 172.0, 18.0, 74.0
_POINTS = 120
_LARGEST = 1e150
_BELOW = 1e-14  # of the largest value, where a logarithmic axis ends at the latest


def thumbnail(charts: Sequence[object]) -> bytes:
    """SVG, light or dark as the page is; nothing where no chart has a curve."""
    known = {chart.name: chart for chart in charts if isinstance(chart, Chart)}
    named = [*(known[name] for name in _ORDER if name in known), *known.values()]
    for chart in named:
        if drawn := _drawn(chart, chart.panels[0]):
            return drawn.encode()
    return b""


def _drawn(chart: Chart, panel: Panel) -> str:
    curves = [(one, points) for one in panel.series if (points := _points(one, panel))]
    every = [point for _, points in curves for point in points]
    if not every:
        return ""
    (left, right), (low, high) = ((min(values), max(values)) for values in zip(*every, strict=True))
    if panel.y_scale == "log":
        low = max(low, high + math.log10(_BELOW))
    if not (right > left and math.isfinite(right - left) and math.isfinite(high - low)):
        return ""
    across, up = (_RIGHT - _LEFT) / (right - left), (_BOTTOM - _TOP) / ((high - low) or 1.0)

    def path(points: Iterable[tuple[float, float]]) -> str:
        places = ((_LEFT + (x - left) * across, _BOTTOM - (max(y, low) - low) * up) for x, y in points)
        return " ".join(f"{x:.1f},{y:.1f}" for x, y in places)

    lines = "".join(
        f'<polyline points="{path(points)}" style="stroke: {_COLOURS.get(series.role, PURPLE)}"/>'
        for series, points in reversed(curves)
    )
    ends = [10.0**value if panel.y_scale == "log" else value for value in (low, high)]
    told = " to ".join(number_text(value, 2) for value in ends)
    span = f"{number_text(left, 3)} to {number_text(right, 3)}"
    unit = panel.x_label.rpartition("(")[2].rstrip(")") if "(" in panel.x_label else ""
    body = (
        f'<g style="fill: none; stroke-width: 1.5">{lines}</g>'
        f'<line x1="{_LEFT}" y1="{_BOTTOM}" x2="{_RIGHT}" y2="{_BOTTOM}" style="stroke: {GREY}"/>'
        f'<g style="fill: {BLACK}"><text x="{_LEFT}" y="12">{told}</text>'
        f'<text x="{_LEFT}" y="{_HEIGHT - 4}">{escape(f"{span} {unit}".strip())}</text></g>'
    )
    return _LIGHT_OR_DARK.format(title=escape(chart.title), body=adaptable(body))


_LIGHT_OR_DARK = (
    f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" width="{_WIDTH}" height="{_HEIGHT}">'
    f"<title>{{title}}</title><style>:root {{{{ {variables(dark=False)} }}}} "
    f"@media (prefers-color-scheme: dark) {{{{ :root {{{{ {variables(dark=True)} }}}} }}}} "
    "text {{ font: 11.5px system-ui, sans-serif; }}</style>{body}</svg>\n"
)


def _points(series: Series, panel: Panel) -> list[tuple[float, float]]:
    """A curve in few points: of each small part its first and its largest, so that no peak is lost."""
    if series.kind not in ("line", "steps", "band"):
        return []
    height = series.y if series.y2 is None else series.y2
    is_log = panel.y_scale == "log"
    points = [
        (float(x), math.log10(y) if is_log else float(y))
        for x, y in zip(series.x, height, strict=False)
        if math.isfinite(x) and math.isfinite(y) and abs(y) < _LARGEST and (y > 0 or not is_log)
    ]
    step = max(1, math.ceil(len(points) / _POINTS))
    kept: list[tuple[float, float]] = []
    for start in range(0, len(points), step):
        part = points[start : start + step]
        kept += [part[0], *([] if step == 1 else [max(part[1:] or part, key=lambda point: abs(point[1]))])]
    return [*kept, *points[-1:]]
