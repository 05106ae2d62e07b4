"""The run of a counterexample, drawn: the error that does not decay, and the slopes that keep it from it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from cdobs_cli.chart import Chart, Panel, Series

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

MAX_SLOPES = 5


def replay_chart(
    name: str, claim: str, arrays: dict[str, NDArray[np.float64]], entries: Sequence[tuple[int, int]]
) -> Chart:
    """|e(t)| with the sampling instants, above V(t).

    Args:
        arrays: t (N,), e (N, size), V (N, slopes), t_k (K,), as the replay stores them.
    """
    import numpy as np

    t, t_k = arrays["t"], arrays["t_k"]
    size = np.sqrt((arrays["e"] ** 2).sum(axis=1))
    after = size[np.minimum(np.searchsorted(t, t_k, side="right") - 1, len(t) - 1)]
    error = Panel(
        "time (s)", "error $|e|$",
        (Series("error", t, size, "line", "refuted"), Series("just after a sample", t_k, after, "points", "measured")),
        "log",
    )  # fmt: skip
    slopes: list[Any] = [
        Panel(
            "time (s)",
            f"$v_{{{i + 1}{j + 1}}}$",
            (Series("slope of the counterexample", t, arrays["V"][:, k], "steps", "refuted"),),
        )
        for k, (i, j) in enumerate(entries[:MAX_SLOPES])
    ]
    return Chart(name, "Counterexample, run", f"The error under the counterexample to {claim}.", (error, *slopes))


def crossing_chart(name: str, claim: str, states: Sequence[str], arrays: dict[str, NDArray[np.float64]]) -> Chart:
    """Each state between its bounds, up to where one of them has crossed it.

    Args:
        arrays: t (N,), x, x_lower, x_upper (N, n), as the replay of a box stores them.
    """
    panels = [
        Panel(
            "time (s)", label,
            (
                Series("lower bound", arrays["t"], arrays["x_lower"][:, j], "line", "estimate"),
                Series("upper bound", arrays["t"], arrays["x_upper"][:, j], "line", "estimate"),
                Series("state", arrays["t"], arrays["x"][:, j], "line", "refuted"),
            ),
        )
        for j, label in enumerate(states[:MAX_SLOPES])
    ]  # fmt: skip
    return Chart(
        name, "Counterexample, run", f"A bound crosses the state under the counterexample to {claim}.", tuple(panels)
    )
