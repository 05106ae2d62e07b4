"""A counterexample drawn: the slopes over time that defeat a claim."""

from __future__ import annotations

from itertools import accumulate

from cdobs_cli.certificate import Check, Claim
from cdobs_cli.chart import Chart, Panel, Series

MAX_PANELS = 6


def witness_charts(check: Check) -> tuple[Chart, ...]:
    """One chart for each counterexample whose slopes switch; constants need no figure."""
    return tuple(witness_chart(claim) for claim in check.claims if _switches(claim))


def _switches(claim: Claim) -> bool:
    witness = claim.witness
    return witness is not None and witness.kind == "switching" and len(witness.times) == len(witness.values) > 1


def witness_chart(claim: Claim) -> Chart:
    """V(t) of a switching witness, one panel a slope, each value held to the end of its arc."""
    witness = claim.witness
    assert witness is not None
    ends = [0.0, *accumulate(float(time) for time in witness.times)]
    count = min(MAX_PANELS, *(len(row) for row in witness.values))
    panels = []
    for k in range(count):
        values = [float(row[k]) for row in witness.values]
        i, j = witness.entries[k] if k < len(witness.entries) else (0, 0)
        name = f"$v_{{{i + 1}{j + 1}}}$" if k < len(witness.entries) else "slope"
        slope = Series("slope of the counterexample", ends, [*values, values[-1]], "steps", "refuted")
        panels.append(Panel("time (s)", name, (slope,)))
    growth = f" The error grows by {witness.multiplier} in size over it." if witness.multiplier else ""
    caption = f"The slopes of the counterexample to {claim.id} over one repetition.{growth}"
    return Chart(witness_name(claim.id), "Counterexample", caption, tuple(panels))


def witness_name(claim: str) -> str:
    """The file name of the chart of a claim's counterexample."""
    return "witness_" + "".join(character if character.isalnum() else "_" for character in claim)
