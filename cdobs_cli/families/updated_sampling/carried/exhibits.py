"""Figures and tables of a carried certificate: Pi and its floor, c(t), the times between samples and why each ended."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.certificate import Check
from cdobs_cli.certify.methods.base import UNREADABLE
from cdobs_cli.chart import Chart, Exhibits, Panel, Series, Table
from cdobs_cli.design import Design
from cdobs_cli.families.updated_sampling.carried.law import Law
from cdobs_cli.families.updated_sampling.carried.typed import stored_law
from cdobs_cli.plant import Plant
from cdobs_cli.run import Run, Trajectory

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

_TIME = "time (s)"
_NEAR = 1e-6  # of kappa: how near the integral is to it where it was the reason
FLOOR, INTEGRAL, REST = "Pi at its floor", "integral of r at kappa", "T_min over"


def exhibits(family: UpdatedSampling, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
    """What the report shows beyond the common figures."""
    try:
        law = stored_law(family, design)
    except UNREADABLE:
        return Exhibits()
    tables = [_law_table(law)]
    if run is None or not run.trajectories or len(run.trajectories[0].t_k) < 2:
        return Exhibits((), tuple(tables))
    first = run.trajectories[0]
    told = reasons(law, first)
    return Exhibits(
        (_periods(first, law, told), _pi(plant, law, first)), (*tables, _counts([*told, *reads(law, first)]))
    )


def reasons(law: Law, run: Trajectory) -> list[str]:
    """Why each sample after the one at 0 was taken: what had been reached just before it."""
    told = []
    for sample, before in zip(run.t_k[1:], run.t_k[:-1], strict=True):
        last = int(np.searchsorted(run.t, sample, side="left"))
        margin = float(run.internals["margin"][min(last, len(run.t) - 1)])
        waited = sample - before <= float(law.T_min) * (1 + _NEAR)
        told.append(REST if waited else FLOOR if abs(margin) <= _NEAR or margin < 0 else INTEGRAL)
    return told


def _periods(run: Trajectory, law: Law, told: list[str]) -> Chart:
    delta, at = np.diff(run.t_k), run.t_k[1:]
    roles: dict[str, Any] = {FLOOR: "measured", INTEGRAL: "estimate", REST: "other"}
    series = []
    for reason, role in roles.items():
        chosen = np.array([one == reason for one in told])
        if chosen.any():
            series.append(Series(reason, at[chosen], delta[chosen], "points", role))
    series.append(Series("guaranteed", [float(at[0])], [float(law.T_min)], "limit", "proved"))
    caption = "The times between samples that the observer chose, by the reason; none is below the line."
    panels = (
        Panel(_TIME, r"$\delta_k$ (s)", tuple(series)),
        Panel(_TIME, "c at the estimate", (Series("c", run.t, run.internals["c"], "line", "other"),)),
    )
    return Chart("sampling", "Updated sampling periods", caption, panels)


def _pi(plant: Plant, law: Law, run: Trajectory) -> Chart:
    """The least eigenvalue of F^-1 Pi along the run: 1 is the floor at samples."""
    n = plant.n
    Pi = np.empty((len(run.t), n, n), dtype=np.float64)
    for i in range(n):
        for j in range(i, n):
            Pi[:, i, j] = Pi[:, j, i] = run.internals[f"Pi_{i + 1}{j + 1}"]
    least = Series("least eigenvalue of Pi over F", run.t, _over(Pi, law.F.floats), "line", "estimate")
    line = Series("floor at samples", [float(run.t[0])], [1.0], "limit", "proved")
    caption = "How far Pi is above F: below T_min it may dip under it, by what is proved; at a sample it never is."
    return Chart("carried", "Carried certificate", caption, (Panel(_TIME, "Pi over F", (least, line)),))


def _over(Pi: Array, F: Array) -> Array:
    root: Array = np.linalg.inv(np.linalg.cholesky(F))
    values: Array = np.array(np.linalg.eigvalsh(root @ Pi @ root.T)[:, 0], dtype=np.float64)
    return values


def _law_table(law: Law) -> Table:
    rows: list[tuple[Any, ...]] = [
        ("F, the floor of Pi at samples", _rows(law.F.texts())),
        ("l, the split of each slope", _rows(law.split.texts())),
        ("Lambda, the weight of each output", _rows(law.Lambda.texts())),
        ("sigma, theta, idle", f"{law.sigma}, {law.theta}, {law.idle}"),
        ("T_min, kappa", f"{law.T_min}, {'none' if law.kappa is None else law.kappa}"),
        ("Pi after a sample", "F + C'Lambda C (reset)" if law.reset else "Pi + C'Lambda C"),
        ("at a sample", "one output is read, the one that takes Pi furthest from F" if law.one else "all are read"),
    ]
    caption = "The constants of the Riccati equation that the observer integrates beside its estimate."
    return Table("law", "Law of the carried certificate", caption, ("constant", "value"), tuple(rows))


def _rows(texts: list[list[str]]) -> str:
    return "[" + ", ".join("[" + ", ".join(row) + "]" for row in texts) + "]"


def reads(law: Law, run: Trajectory) -> list[str]:
    """Which output each sample after the one at 0 read, where one is chosen."""
    if not law.one:
        return []
    before = np.searchsorted(run.t, run.t_k[1:], side="left").clip(max=len(run.t) - 1)
    return [f"output {round(float(run.internals['read'][at]))} read" for at in before]


def _counts(told: list[str]) -> Table:
    chosen = sorted(set(told) - {FLOOR, INTEGRAL, REST})
    rows = tuple((reason, str(told.count(reason))) for reason in (FLOOR, INTEGRAL, REST, *chosen))
    return Table(
        "reasons", "Why samples were taken", "Of the first run, after the one at 0.", ("reason", "samples"), rows
    )
