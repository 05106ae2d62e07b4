"""V at the samples, and the feasible period against the size of the slopes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from cdobs_cli.certificate import Certificate, Check
from cdobs_cli.certify.methods.base import read
from cdobs_cli.chart import Chart, Exhibits, Panel, Series
from cdobs_cli.design import Design
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability.canonical import LastRow, Number, delta_star, last_row
from cdobs_cli.families.reachability.certificate import ReachableSet
from cdobs_cli.families.reachability.messages import messages_charts
from cdobs_cli.families.reachability.structure import is_chain
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.run import Run

if TYPE_CHECKING:
    from cdobs_cli.families.reachability import Reachability

FACTORS = (Fraction(1, 8), Fraction(1, 4), Fraction(1, 2), Fraction(1), Fraction(2), Fraction(4), Fraction(8))


def exhibits(family: Reachability, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
    """Charts where there is something to draw."""
    charts = messages_charts(plant, design, run)
    certificate = _own(design)
    contraction = check.claim("set.contraction") if check is not None else None
    if certificate is not None and run is not None and contraction is not None and contraction.status == "proved":
        charts += _lyapunov(plant, design, certificate, run)
    about_periods = family.method != "clock" and family.set == "clarke" and not design.sampling.is_on_change
    if about_periods and not plant.output_quantities:
        charts += _periods(family, plant, design, check)
    return Exhibits(tuple(charts), (), _notes(family, design))


def _own(design: Design) -> ReachableSet | None:
    """The set certificate of the design's gain and law."""
    stored = (read(one, (ReachableSet,), ("K",)) for one in design.certificates if one.sampling == design.sampling)
    methods = (one.method for one in stored if one is not None and one.gain is None)
    return next((method for method in methods if isinstance(method, ReachableSet)), None)


def _lyapunov(plant: Plant, design: Design, certificate: ReachableSet, run: Run) -> list[Chart]:
    """V(t_k+) along the first run, and the proved geometric bound from its first value."""
    if plant.delays:  # V falls from stamp to stamp, where a late estimate does not know the samples yet
        return []
    trajectory = run.trajectories[0]
    error = trajectory.estimates["x_hat"] - trajectory.x
    P = certificate.decrease(plant, design.gain["K"])
    if P is None:
        return []
    # Just after each jump: the last output row at that instant.
    after = np.searchsorted(trajectory.t, trajectory.t_k, side="right") - 1
    V = np.einsum("ki,ij,kj->k", error[after], P, error[after])
    floor = 1e-24 * max(float(np.max(V, initial=0.0)), 1e-300)
    shown = np.isfinite(V) & (floor < V)
    if shown.sum() < 2:
        return []
    t, V = trajectory.t_k[shown], V[shown]
    bound = V[0] * float(certificate.rho_squared) ** np.arange(len(V))
    # Below the integrator's accuracy the measured V says nothing; nor does a bound far below it, under noise.
    keep = bound > max(1e-24 * V[0], 0.01 * float(V.min()))
    series = (
        Series("V after each jump", t, V, "points", "measured"),
        Series("proved bound", t[keep], bound[keep], "line", "proved"),
    )
    caption = "V = e'Pe just after each jump, and the proved bound rho^(2k) from its first value."
    if plant.is_perturbed:
        caption += " The bound holds without disturbance and noise."
    return [Chart("lyapunov", "Lyapunov function at the samples", caption, (Panel("time (s)", "V", series, "log"),))]


def _periods(family: Reachability, plant: Plant, design: Design, check: Check | None) -> list[Chart]:
    """delta_star and the largest period of the set against a factor on all slopes."""
    if not plant.slopes.uncertain or not is_chain(plant):
        return []
    row = last_row(plant)
    limits = [delta_star(LastRow(_scaled(row.lo, factor), _scaled(row.hi, factor))) for factor in FACTORS]
    factors = [float(f) for f in FACTORS]
    finite = [(f, float(limit.mid())) for f, limit in zip(factors, limits, strict=True) if limit.is_finite()]
    series: list[Series] = []
    if finite:
        series.append(
            Series("delta_star, (31) holds below", [f for f, _ in finite], [d for _, d in finite], "line", "other")
        )
    periods = _largest_periods(family, plant, design, check)
    if periods:
        series.append(
            Series("largest period of the set", [f for f, _ in periods], [d for _, d in periods], "line", "proved")
        )
    if not series:
        return []
    series.append(Series("this design", [1.0], [float(design.sampling.T_max)], "points", "measured"))
    caption = (
        "All slope bounds times a factor: up to which period the set of Theorem III.2 holds, and up to "
        "which it gives a gain."
    )
    return [
        Chart(
            "feasible_period",
            "Feasible period",
            caption,
            (Panel("factor on the slopes", "period (s)", tuple(series), "log", "log"),),
        )
    ]


def _scaled(values: tuple[Number, ...], factor: Fraction) -> tuple[Number, ...]:
    return tuple(value * (factor if isinstance(value, Fraction) else fraction_ball(factor)) for value in values)


def _largest_periods(
    family: Reachability, plant: Plant, design: Design, check: Check | None
) -> list[tuple[float, float]]:
    """By search for two states (no solver); by time scaling from the longest one proved where a single slope is
    uncertain: c_k s^(n-k+1) goes with delta / s."""
    stored = max(
        (c for c in design.certificates if c.method == ReachableSet.name),
        key=lambda c: float(c.sampling.T_max),
        default=None,
    )
    if plant.n == 2 and plant.p == 1:
        from cdobs_cli.families.reachability.set_design import end_of_any

        ends = []
        for factor in FACTORS:
            bounds = Slopes(_times(plant.slopes.lower, factor), _times(plant.slopes.upper, factor), plant.slopes.auto)
            about = family.question(replace(plant, slopes=bounds, sampling=design.sampling), {}, 0)
            ends.append((float(factor), end_of_any(about)))
        return [(factor, end) for factor, end in ends if end]
    entries = plant.slopes.uncertain
    zero_row = all(plant.A[plant.n - 1, j].sign() == 0 for j in range(plant.n))
    any_gain = [c for c in design.certificates if c.method == ReachableSet.name and "K" in c.data]
    if len(entries) != 1 or not zero_row or not (any_gain or family.objective == "max_period"):
        return []
    if stored is None or not _is_proved(stored, check):
        return []
    power = 1.0 / (plant.n - entries[0][1])
    return [(float(f), float(stored.sampling.T_max) * float(f) ** -power) for f in FACTORS]


def _is_proved(stored: Certificate, check: Check | None) -> bool:
    """Whether the check has proved the period of a stored certificate, for this gain or for some gain."""
    names = (f"period_max.{ReachableSet.name}", "period_max_any_gain")
    ends = [bound.proved for name in names if check is not None and (bound := check.bounds.get(name)) is not None]
    # The end may be the period rounded down to 12 digits.
    T = float(stored.sampling.T_max)
    return any(end == "inf" or (end is not None and float(Exact(end)) * (1 + 1e-11) >= T) for end in ends)


def _times(matrix: ExactMatrix, factor: Fraction) -> ExactMatrix:
    return ExactMatrix([[value * Exact(factor) for value in row] for row in matrix.rows])


def _notes(family: Reachability, design: Design) -> tuple[str, ...]:
    notes: list[str] = []
    if family.set != "clarke":
        notes.append("The set M is the typed one; that it holds every reachable error is the claim set.inclusion.")
    if design.sampling.is_periodic:
        notes.append("For constant periods a proof at one period says nothing of a shorter one.")
    return tuple(notes)
