"""Counterexamples in words."""

from __future__ import annotations

from fractions import Fraction

from report_pendulum import make_plant

from cdobs_cli.certificate import Witness
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.report.counterexamples import in_words
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Sensor

LAW = SamplingLaw.periodic(Exact("1.5"))
ENTRY = ((1, 0),)


def told(witness: Witness, law: SamplingLaw = LAW) -> str:
    return in_words(witness, make_plant(), law, "s")


def test_constant_slopes() -> None:
    witness = Witness("constant", "class", ("1.5",), (("-1",),), "1.76076334323", ENTRY, {"arcs": [1]})
    assert told(witness) == (
        "Samples come every 1.5 s, while d phi_omega / d theta is -1, again and again. Some error is then at least "
        "1.76 times as large from sample to sample. Some plant with these slopes does so; the typed one may still "
        "converge."
    )


def test_slopes_that_switch_over_several_periods() -> None:
    values = (("1",), ("-1",), ("-1",))
    witness = Witness("switching", "plant", ("0.3", "0.7", "1.5"), values, "1", ENTRY, {"arcs": [2, 1]})
    assert told(witness) == (
        "Samples come after 1 s, 1.5 s, while d phi_omega / d theta is 1 for 0.3 s, -1 for 2.2 s, again and again. "
        "Some error then never decays. The plant as typed does so."
    )


def test_what_is_read_and_what_is_lost() -> None:
    law = SamplingLaw.multirate(Exact("0.3"), [Sensor("camera", (0,), Fraction(1), lost=1)])
    witness = Witness("constant", "class", ("0.3", "0.3"), (("1",), ("1",)), "2", ENTRY,
                      {"arcs": [1, 1], "readings": [None, 1]})  # fmt: skip
    assert told(witness, law).startswith("Samples come after 0.3 s (nothing arrives), 0.3 s (camera), while ")
    assert "at least 2 times as large each time" in told(witness, law)


def test_an_error_that_is_never_seen() -> None:
    data = {"arcs": [1], "direction": ["1", "-1/2"], "states": ["theta", "omega"]}
    witness = Witness("vector", "class", ("1.5",), (("1",),), None, ENTRY, data)
    first = "An error along 1 theta - 0.5 omega is never seen by a measurement, with d phi_omega / d theta = 1."
    assert told(witness).startswith(first)


def test_other_kinds() -> None:
    assert told(Witness("noise", "class")).startswith("Slopes, disturbance and noise, repeated again and again")
    assert told(Witness("noise", "class")).endswith("the typed one may stay below.")
    assert told(Witness("point", "plant", values=(("1", "2"),))).startswith("At one point of the domain")
    assert told(Witness("box", "plant")).startswith("A box of x(0) and a word of sampling periods")
    assert told(Witness("vector", "plant", data={"width": ["1"]})).startswith("These numbers defeat the claim.")
