"""Refutations of the bounds that the intersection with y undoes, and periods shorter than the least acceptable."""

import pytest
from interval_plants import plant, scalar

from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.interval import Gain, Interval
from cdobs_cli.sampling import SamplingLaw


def law(T):
    return SamplingLaw.periodic(Exact(T))


def checked(card, at):
    design = card.synthesize(at, 0)
    return design, card.certify(at, design, 0)


@pytest.mark.parametrize(("L", "part"), [("-2", "boundedness"), ("6", "positivity")])
def test_a_state_measured_without_noise_is_known_after_each_sample(L, part):
    """Each sample cuts the width to 0: what breaks the bounds without the cut does not break them with it."""
    at = scalar(law("1"))
    gain = Gain(S=[[1]], L=[[L]])
    _, plain = checked(Interval(gain=gain), at)
    assert plain.verdict == "refuted" and plain.claim(part).status == "refuted"
    _, cut = checked(Interval(gain=gain, tighten="intersect"), at)
    assert cut.verdict == "undecided"
    assert cut.claim(part).status == ("refuted" if part == "boundedness" else "undecided")


def test_an_error_that_no_row_of_the_output_cuts_is_still_refuted():
    at = plant([["-1", "0"], ["0", "1"]], [["1", "0"]], law("0.5"))
    gain = Gain(S=[["1", "0"], ["0", "1"]], L=[["1"], ["0"]])
    _, check = checked(Interval(gain=gain, tighten="intersect"), at)
    assert check.claim("boundedness").status == "refuted"
    assert check.verdict == "refuted"


@pytest.mark.parametrize("tighten", ["none", "hull"])
def test_a_given_gain_is_not_proved_at_less_than_the_least_acceptable_period(tighten):
    asked = law("5")
    family = Interval(gain=Gain(S=[[1]], L=[["1.4"]]), objective="max_period", tighten=tighten)
    design, check = checked(family, scalar(asked))
    assert design.sampling == asked
    assert check.verdict != "proved"
    design, check = checked(family, scalar(law("0.1")))
    assert float(design.sampling.T_max) > 0.1 and check.verdict == "proved"
