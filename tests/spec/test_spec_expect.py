"""Expectations: paths into artefacts, exact comparison, and what fails."""

from __future__ import annotations

import pytest

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.spec.expect import Expectation, evaluate, resolve

DOCUMENT = {
    "design": {"outcome": "found", "gain": {"K": [["1"], ["1.8361"]]}, "solver": None},
    "check": {
        "verdict": "proved",
        "claims": [
            {"id": "slopes.1.2", "status": "proved", "margin": None},
            {"id": "slopes.1.20", "status": "refuted"},
            {"id": "convergence", "status": "undecided", "by": ["clock"]},
        ],
        "bounds": {
            "period_max": {"proved": "0.66815", "refuted": None},
            "period_max.set": {"proved": "0.1", "refuted": "inf"},
            "decay_rate": {"proved": "1/3"},
        },
    },
    "simulation": {
        "overall": {"diverged": False, "rmse": {"theta": 0.1}, "measurements": 34},
        "runs": [{"error_final": 1e-07}],
    },
}


@pytest.mark.parametrize(
    ("path", "value"),
    [
        ("verdict", "proved"),
        ("check.verdict", "proved"),
        ("claims.convergence.status", "undecided"),
        ("claims.slopes.1.2.status", "proved"),
        ("claims.slopes.1.20.status", "refuted"),
        ("claims[0].id", "slopes.1.2"),
        ("bounds.period_max.proved", "0.66815"),
        ("bounds.period_max.set.proved", "0.1"),
        ("design.gain.K[1][0]", "1.8361"),
        ("simulation.runs.0.error_final", 1e-07),
        ("simulation.overall.rmse.theta", 0.1),
        ("claims.nothing.status", None),
        ("claims.slopes.1.status", None),
        ("bounds.period_max.proved.more", None),
        ("design.solver.name", None),
        ("design.gain.K[2][0]", None),
    ],
)
def test_paths(path, value):
    assert resolve(path, DOCUMENT) == value


def holds(quantity, relation, value, tolerance=None):
    value = value if isinstance(value, bool) or value in ("proved", "found", "inf") else Exact(value)
    return evaluate(
        Expectation(quantity, relation, value, None if tolerance is None else Exact(tolerance)), DOCUMENT
    ).holds


@pytest.mark.parametrize(
    ("quantity", "relation", "value", "expected"),
    [
        ("bounds.period_max.proved", "at_least", "0.66815", True),
        ("bounds.period_max.proved", "at_least", "0.668150000000000000000000000001", False),
        ("bounds.period_max.proved", "at_most", "0.66815", True),
        ("bounds.period_max.proved", "at_most", "0.66814999999999999999999999999", False),
        ("bounds.period_max.proved", "equals", "0.668150", True),
        ("bounds.decay_rate.proved", "equals", "1/3", True),
        ("bounds.decay_rate.proved", "at_most", "sqrt(1/9) + 1e-30", True),
        ("bounds.decay_rate.proved", "at_least", "pi/9", False),
        ("bounds.period_max.refuted", "at_least", "0", False),
        ("bounds.period_max.set.refuted", "at_least", "1e9", True),
        ("bounds.period_max.set.refuted", "at_most", "1e9", False),
        ("bounds.period_max.set.refuted", "equals", "inf", True),
        ("verdict", "equals", "proved", True),
        ("verdict", "at_least", "proved", False),
        ("claims.convergence.status", "equals", "proved", False),
        ("verdict", "equals", "1", False),
        ("simulation.overall.diverged", "equals", False, True),
        ("simulation.overall.diverged", "equals", True, False),
        ("simulation.overall.diverged", "at_most", "1", False),
        ("simulation.overall.rmse.theta", "equals", "0.1", True),
        ("simulation.overall.measurements", "equals", "34", True),
        ("simulation.runs[0].error_final", "at_most", "1e-7", True),
        ("bounds.period_max", "at_least", "0", False),
        ("bounds.nothing.proved", "at_most", "1", False),
        ("design.outcome", "equals", "found", True),
    ],
)
def test_relations(quantity, relation, value, expected):
    assert holds(quantity, relation, value) is expected


def test_tolerance_is_exact():
    assert holds("bounds.period_max.proved", "equals", "0.67", "0.00185")
    assert not holds("bounds.period_max.proved", "equals", "0.67", "0.00184999999999999999999")


def test_an_absent_artefact_fails():
    entry = Expectation("simulation.overall.diverged", "equals", False)
    assert entry.artefact == "simulation"
    assert not evaluate(entry, {"design": None, "check": None, "simulation": None}).holds


def test_the_sentence_says_what_was_found_and_where_it_comes_from():
    entry = Expectation("bounds.period_max.proved", "at_least", Exact("0.7"), source="Dinh2014")
    assert evaluate(entry, DOCUMENT).text == "bounds.period_max.proved at least 0.7: fails, it is 0.66815 (Dinh2014)"


@pytest.mark.parametrize(
    ("typed", "value"),
    [
        ("equals: proved", "proved"),
        ("equals: '0.5'", Exact("1/2")),
        ("equals: 0.5", Exact("1/2")),
        ("equals: true", True),
        ('equals: "pi"', Exact("pi")),
    ],
)
def test_values_of_equals(loaded, typed, value):
    entry = loaded(("at_least: 0.6", typed)).expect[0]
    assert (entry.relation, entry.value) == ("equals", value)
