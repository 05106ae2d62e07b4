"""Figures and tables of this family: held outputs, the spectral radii, period against rate, the ladder."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from cdobs_cli.certificate import Check
from cdobs_cli.chart import Chart, Exhibits, Panel, Role, Series, Table
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.lpv_zoh.observer import INNOVATION
from cdobs_cli.plant import Plant
from cdobs_cli.run import Run

if TYPE_CHECKING:
    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold

_NOTES = (
    "The printed proof of Theorem 1 does not hold as it stands: V_2 with the lower limit t_k has no negative "
    "term in its "
    "derivative, so the limit must be t - tau_max; alpha_1 should be mu / lambda_max(P) and beta divide by "
    "lambda_min(P); "
    "alpha is the smaller of alpha_1, alpha_2, and alpha_2 = (delta - 1) / (delta tau_max). "
    "Claims named theorem_1 test the conditions as printed; convergence never rests on them.",
)


def exhibits(family: LpvZeroOrderHold, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
    """What the report shows beyond the common figures."""
    if design.outcome == "none":
        return Exhibits()
    charts = [*_held_outputs(plant, run), *_curve(plant, design, check)]
    numbers = _numbers(family, plant, design)
    return Exhibits(tuple(charts), (_radii(family, plant, design), *numbers), _NOTES if numbers else ())


def _numbers(family: LpvZeroOrderHold, plant: Plant, design: Design) -> list[Table]:
    """What Theorem 1 and Remark 2 compute from the printed (P, Y) at the period of the law."""
    from cdobs_cli.families.lpv_zoh.printed import evaluate
    from cdobs_cli.families.lpv_zoh.printed_claims import printed_data

    tables = []
    for prefix, where, data in printed_data(family, plant, design):
        numbers = evaluate(data, design.sampling.T_max.scalar).document()
        rows = tuple((name, low, high) for name, (low, high) in numbers.items())
        caption = (
            f"Theorem 1 and Remark 2 of Boukal2020 as printed, {where}. delta is the least with beta < alpha_2; "
            f"mu, alpha_2 and T_2 "
            "are taken there, alpha_1 and T_1 at the mu of delta = 1, the most they can be."
        )
        tables.append(
            Table(prefix.replace(".", "_"), "Numbers of the printed theorem", caption, ("number", "from", "to"), rows)
        )
    return tables


def _held_outputs(plant: Plant, run: Run | None) -> list[Chart]:
    """The measurement y(t_k) and the observer's own output C x_hat(t_k), or h, both held, and their difference."""
    if run is None or not run.trajectories or not len(run.trajectories[0].t_k):
        return []
    if plant.delays:  # the innovation of a sample is not known at its stamp
        return []
    import numpy as np

    first = run.trajectories[0]
    panels, held_too = [], False
    for k in range(plant.p):
        held = first.internals.get(f"{INNOVATION}{k}")
        if held is None:
            return []
        after = np.searchsorted(first.t, first.t_k, side="right") - 1
        innovation = np.asarray(held)[after]
        y = first.y_k[:, k]
        ends = np.append(first.t_k, first.t[-1])
        series = (
            Series("measured", ends, _to_end(y), "steps", "measured"),
            Series("observer", ends, _to_end(y - innovation), "steps", "estimate"),
        )
        if not _is_state(plant, k):  # else its samples are drawn on the state
            panels.append(Panel("time (s)", f"$y_{{{k + 1}}}(t_k)$", series))
            held_too = True
        drives = Series("innovation", ends, _to_end(innovation), "steps", "other")
        panels.append(Panel("time (s)", f"$r_{{{k + 1}}}(t_k)$", (drives,)))
    if not held_too:
        caption = "What is measured less what the observer expects, held between samples: it drives the observer."
        return [Chart("held_outputs", "Innovations", caption, tuple(panels))]
    caption = (
        "Sampled outputs of the plant and of the observer, held between samples, and the innovation that "
        "drives the observer."
    )
    return [Chart("held_outputs", "Held outputs", caption, tuple(panels))]


def _is_state(plant: Plant, k: int) -> bool:
    """Whether an output is a multiple of one state."""
    return plant.h is None and sum(float(plant.C[k, j]) != 0 for j in range(plant.n)) == 1


def _to_end(values: Any) -> Any:
    """The last value once more: held to the end of the run."""
    import numpy as np

    return np.append(values, values[-1])


def _curve(plant: Plant, design: Design, check: Check | None) -> list[Chart]:
    """The rate that can be proved at each largest period."""
    try:
        own = [(float(point["period"]), float(point["rate"])) for point in design.details.get("curve", [])]
    except (AttributeError, KeyError, TypeError, ValueError):  # not what synthesis writes
        return []
    others = [(float(Exact(one.period)), float(Exact(one.rate))) for one in design.front if one.rate and not one.error]
    shown: tuple[tuple[str, list[tuple[float, float]], Role], ...] = (
        ("convex synthesis, a gain for each period", others, "other"), ("this gain", own, "estimate"),
    )  # fmt: skip
    series = [
        Series(label, [period for period, _ in points], [rate for _, rate in points], "line", role)
        for label, points, role in shown
        if points
    ]
    if not series:
        return []
    bound = None if check is None else check.bounds.get("period_max")
    if bound is not None and bound.refuted not in (None, "inf"):
        series.append(Series("this gain refuted", [float(bound.refuted or 0)], [0.0], "mark", "refuted"))
    law = "the sampling period" if plant.sampling.is_periodic else "the largest sampling period"
    caption = (
        f"The decay rate against {law}. Each point was proved when it was found; what `check` proves "
        f"again is this design at its law."
    )
    return [
        Chart("period_rate", "Period against rate", caption, (Panel("period (s)", "proved rate (1/s)", tuple(series)),))
    ]


def _radii(family: LpvZeroOrderHold, plant: Plant, design: Design) -> Table:
    """Spectral radii of the sampled error at constant slopes and the largest period."""
    import numpy as np

    from cdobs_cli.certify.floats import exponentials, spectral_radii

    system = family.inclusion(replace(plant, sampling=design.sampling), design.gain)
    maps = system.floats
    T = float(design.sampling.T_max)
    rows: list[tuple[Any, ...]] = []
    for name, share in (("lower ends", 0.0), ("middle", 0.5), ("upper ends", 1.0)):
        v = tuple(low + share * (high - low) for low, high in zip(maps.lower, maps.upper, strict=True))
        rho = float(spectral_radii(maps.jump @ exponentials(np.array([maps.flow(v) * T])))[0])
        rows.append((name, rho))
    return Table(
        "sampled_radii", "Spectral radius of the sampled error",
        "At constant slopes and the largest period of the law; below 1 the error of that linear member of the "
        "class converges. "
        "Computed in floating point: an illustration, not a proof.",
        ("slopes", "spectral radius"), tuple(rows),
    )  # fmt: skip
