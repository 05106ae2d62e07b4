"""The run of a counterexample, drawn: the error that does not decay, and the slopes that keep it from it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.chart import Chart, Panel, Series

MAX_SLOPES = 5


def replay_chart(name: str, claim: str, arrays: dict[str, Array], entries: Sequence[tuple[int, int]]) -> Chart:
    """|e(t)| with the sampling instants, above V(t).

    Args:
        arrays: t (N,), e (N, size), V (N, slopes), t_k (K,), as the replay stores them.
    """
    t, t_k = arrays["t"], arrays["t_k"]
    size = np.sqrt((arrays["e"] ** 2).sum(axis=1))
    after = size[np.minimum(np.searchsorted(t, t_k, side="right") - 1, len(t) - 1)]
    samples = Series("just after a sample", t_k, after, "points", "measured")
    error = Panel("time (s)", "error $|e|$", (Series("error", t, size, "line", "refuted"), samples), "log")
    slopes = []
    for k, (i, j) in enumerate(entries[:MAX_SLOPES]):
        slope = Series("slope of the counterexample", t, arrays["V"][:, k], "steps", "refuted")
        slopes.append(Panel("time (s)", f"$v_{{{i + 1}{j + 1}}}$", (slope,)))
    return Chart(name, "Counterexample, run", f"The error under the counterexample to {claim}.", (error, *slopes))


def attained_chart(
    name: str, claim: str, label: str, state: int, arrays: dict[str, Array], entries: Sequence[tuple[int, int]]
) -> Chart:
    """The error of one state, where it is as large as was proved, above V(t) and the disturbance.

    Args:
        arrays: t (N,), e (N, size), V (N, slopes), d (N, n), at (M,), as the replay stores them.
    """
    t, e, at = arrays["t"], arrays["e"][:, state], arrays["at"]
    reached = Series("as large as was proved", t[at], e[at], "points", "refuted")
    panels = [Panel("time (s)", f"error of {label}", (Series("error", t, e, "line", "refuted"), reached))]
    for k, (i, j) in enumerate(entries[:MAX_SLOPES]):
        slope = Series("slope of the counterexample", t, arrays["V"][:, k], "steps", "refuted")
        panels.append(Panel("time (s)", f"$v_{{{i + 1}{j + 1}}}$", (slope,)))
    for j in np.flatnonzero(np.any(arrays["d"], axis=0))[:MAX_SLOPES]:
        fed = Series("disturbance of the counterexample", t, arrays["d"][:, j], "steps", "refuted")
        panels.append(Panel("time (s)", f"$d_{{{j + 1}}}$", (fed,)))
    return Chart(name, "Counterexample, run", f"The error under the counterexample of {claim}.", tuple(panels))


def crossing_chart(name: str, claim: str, states: Sequence[str], arrays: dict[str, Array]) -> Chart:
    """Each state between its bounds, up to where one of them has crossed it.

    Args:
        arrays: t (N,), x, x_lower, x_upper (N, n), as the replay of a box stores them.
    """
    panels = []
    for j, label in enumerate(states[:MAX_SLOPES]):
        lower = Series("lower bound", arrays["t"], arrays["x_lower"][:, j], "line", "estimate")
        upper = Series("upper bound", arrays["t"], arrays["x_upper"][:, j], "line", "estimate")
        state = Series("state", arrays["t"], arrays["x"][:, j], "line", "refuted")
        panels.append(Panel("time (s)", label, (lower, upper, state)))
    caption = f"A bound crosses the state under the counterexample to {claim}."
    return Chart(name, "Counterexample, run", caption, tuple(panels))
