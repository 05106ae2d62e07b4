"""Samples of a constant period, some of them lost: the law, certificates at its points, and words of its multiples."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import PENDULUM, made
from designing import designed
from example_inclusions import canonical, impulsive, plant

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify import search
from cdobs_cli.certify.falsify import every_gain_fails_from, refute
from cdobs_cli.certify.floats import exponentials, spectral_radii
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import Clock, design_impulsive
from cdobs_cli.certify.methods.counterexample import Counterexample
from cdobs_cli.certify.methods.rung import GENERAL
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.certify.words import Arc, Word, prove, refutes
from cdobs_cli.exact.numbers import Exact, decimal_text
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.sampling import SamplingLaw


def lossy(h: Any, lost: int) -> SamplingLaw:
    return SamplingLaw.periodic(Exact(h), lost)


def test_what_the_law_holds() -> None:
    law = lossy("0.1", 2)
    assert [str(gap) for gap in law.multiples] == ["0.1", "0.2", "0.3"]
    assert (str(law.period), str(law.T_max), law.is_periodic) == ("0.1", "0.3", False)
    held = [lossy("0.1", 2), lossy("0.1", 1), SamplingLaw.periodic(Exact("0.2")), SamplingLaw.periodic(Exact("0.3"))]
    assert all(law.contains(one) for one in held)
    others = [lossy("0.1", 3), lossy("0.2", 1), SamplingLaw.periodic(Exact("0.25")), SamplingLaw.periodic(Exact("0.4"))]
    assert not any(law.contains(one) for one in others)
    interval = SamplingLaw("aperiodic", Exact("0.1"), Exact("0.3"))
    assert interval.contains(law) and not law.contains(interval)
    assert SamplingLaw.from_document(law.document()) == law and law.with_period(Exact("0.5")) == lossy("0.5", 2)
    assert lossy("0.1", 0) == SamplingLaw.periodic(Exact("0.1"))
    for lost in (0, -1, True, "2", 1000):
        with pytest.raises(ValueError, match="not a sampling law"):
            SamplingLaw.from_document({"period": "0.1", "lost": lost})


@pytest.mark.parametrize(("n", "lost", "least"), [(2, 0, 1.616), (2, 1, 1.616), (2, 2, 1.637), (2, 3, 1.616),
                                                  (3, 1, 1.391), (3, 2, 1.387), (3, 3, 1.346)])  # fmt: skip
def test_the_longest_gap_of_chains_with_one_gain(n: int, lost: int, least: float) -> None:
    """Theory, measurement schemes, (c): the largest (m + 1) h with one K; pendulum and chain of three."""
    question = Question(impulsive(canonical([1] + [0] * (n - 1), lossy("0.3", lost)), [["0"]] * n), effort=1)
    met = search.largest(lambda T: design_impulsive(question.at(T)), Exact("0.3"), Fraction(1, 200))
    assert met is not None
    h, (K, clock) = met
    assert float(h) * (lost + 1) > least * 0.995
    closed = question.at(h).with_gain({"K": K})
    assert clock.prove(closed).holds
    worst = refute(question.at(Exact(decimal_text(1.15 * float(h), 6))).with_gain({"K": K}).inclusion, 1)
    assert worst is not None, "the same gain fails not far above"


def test_a_clock_certificate_is_of_its_points_only() -> None:
    question = Question(impulsive(canonical([1, 0], lossy("0.4", 2)), [["1"], ["0.75"]]), effort=1)
    clock = Clock.propose(question)
    assert clock is not None and clock.prove(question).holds
    for other in (lossy("0.4", 3), lossy("0.5", 2)):
        moved = Clock(other, clock.degree, clock.elevated, clock.pieces, clock.sigma, clock.basis, clock.P)
        assert not moved.prove(question).holds


@pytest.mark.parametrize("seed", range(12))
def test_linear_loops_against_every_word_of_their_gaps(seed: int) -> None:
    """Proved and refuted periods beside brute force: products of all words of up to six gaps."""
    rng = np.random.default_rng(seed)
    lost = int(rng.integers(1, 4))
    A = [[decimal_text(float(v), 3) for v in row] for row in rng.standard_normal((2, 2))]
    gain = [[decimal_text(float(v), 3)] for v in rng.uniform(0.2, 1.2, 2)]
    zero = [[0, 0], [0, 0]]
    question = Question(impulsive(plant(A, zero, zero, [[1, 0]], lossy("0.2", lost)), gain), effort=1)
    maps = question.inclusion.floats

    def largest(h: float) -> float:
        letters = maps.jump @ exponentials(maps.base * (h * np.arange(1, lost + 2))[:, None, None])
        radii = [0.0]
        for count in range(1, 7 if lost < 3 else 6):
            total = np.eye(2)[None]
            for _ in range(count):
                total = (letters[:, None] @ total[None]).reshape(-1, 2, 2)
            radii.append(float(spectral_radii(total).max()) ** (1 / count))
        return max(radii)

    proved = GENERAL.longest(question)
    if proved is None:
        assert largest(0.2 / 1.6**20) > 0.99
        return
    end = float(proved.law.period)
    assert proved.prove(question).holds and largest(end) < 1
    found = Counterexample.shortest(question, proved.law.period)
    if found is None:
        return
    assert found.prove(question).holds
    assert end < float(found.law.period) <= 1.12 * end, "forms and words meet"


def test_a_word_between_the_points_is_no_counterexample() -> None:
    inclusion = impulsive(plant([[0, 1], [-40, 0]], [[0, 0], [0, 0]], [[0, 0], [0, 0]], [[1, 0]], lossy("0.2", 2)),
                          [["1"], ["0"]])  # fmt: skip
    for length, allowed in (
        ("0.2", True),
        ("0.4", True),
        ("0.6", True),
        ("0.3", False),
        ("0.8", False),
        ("0.1", False),
    ):
        word = Word(((Arc(Exact(length), ()),),))
        radius = prove(inclusion, word)
        assert allowed or radius is None
    witness = refute(inclusion, 1)
    assert witness is None or refutes(inclusion, witness)


def test_every_second_sample_may_be_lost_for_ever() -> None:
    """An oscillator of half period 0.2 seen every 0.1 is seen; where every second sample is lost it is not."""
    zero = [[0, 0], [0, 0]]
    exact = [[0, "5*pi"], ["-5*pi", 0]]
    assert unseen(plant(exact, zero, zero, [[1, 0]], SamplingLaw.periodic(Exact("0.1")))) is None
    hidden = unseen(plant(exact, zero, zero, [[1, 0]], lossy("0.1", 1)))
    assert hidden is not None and str(hidden.period) == "0.2"


def test_a_spec_with_losses_from_end_to_end(tmp_path: Path) -> None:
    text = PENDULUM.replace("period: 0.6}", "period: 0.2}\n  lost: {at_most: 3}").replace("  method: set\n", "")
    result = made(tmp_path, text)
    assert result.status == "ok" and result.check is not None and result.simulation is not None
    (convergence,) = [claim for claim in result.check["claims"] if claim["id"] == "convergence"]
    assert "sampling every 0.2, at most 3 in a row lost" in convergence["statement"]
    assert 0.2 <= float(result.check["bounds"]["period_max"]["proved"]) < 0.5
    with np.load(tmp_path / "out" / "simulation.npz") as arrays:
        gaps = np.diff(arrays["t_k"]) / 0.2
    assert np.allclose(gaps, np.round(gaps)) and set(np.round(gaps)) == {1, 2, 3, 4}
    assert "lost sample" in (tmp_path / "out" / "figures" / "states.csv").read_text()


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            ("family: reachability\n  method: set", "family: lpv_zoh"),
            "measurement.lost: family reachability takes lost",
        ),
        (("period: 0.2", "max_period: 0.2"), "losses are counted in samples of a constant period"),
        (("at_most: 3", "at_most: -1"), "measurement.lost.at_most"),
        (("at_most: 3", "at_most: 1.5"), "measurement.lost.at_most"),
        (("{at_most: 3}", "{}"), "measurement.lost: one kind of loss is expected"),
        (("{at_most: 3}", "{at_most: 3, probability: 0.1}"), "measurement.lost: one kind of loss is expected"),
        (("{at_most: 3}", "{probability: 1}"), "a probability below 1 is expected"),
        (("{at_most: 3}", "{probability: -0.1}"), "measurement.lost.probability"),
        (("initial_state", "sampling_times: 0.3\n  initial_state"), "a period outside the sampling law"),
    ],
)
def test_what_is_refused(tmp_path: Path, change: tuple[str, str], told: str) -> None:
    text = PENDULUM.replace("period: 0.6}", "period: 0.2}\n  lost: {at_most: 3}").replace("  method: set\n", "")
    text = (
        text.replace("family: reachability", "family: reachability\n  method: set") if "method" in change[0] else text
    )
    result = made(tmp_path, text.replace(*change))
    assert result.status == "invalid" and any(told in str(message) for message in result.messages)


# ---------------------------------------------------------------- by chance


def by_chance(h: Any, p: Any) -> SamplingLaw:
    return SamplingLaw.randomly(Exact(h), Exact(p))


def mean_radius(question: Question, p: float) -> float:
    """rho of E e e' -> E e+ e+' over a period, at the worst constant corner."""
    maps, T = question.inclusion.floats, float(question.law.period)
    radii = []
    for A in maps.corners():
        F = exponentials(A[None] * T)[0]
        JF = maps.jump @ F
        radii.append(float(spectral_radii((np.kron(JF, JF) * (1 - p) + np.kron(F, F) * p)[None])[0]))
    return max(radii)


def test_a_law_of_chance_is_held_by_no_other() -> None:
    law = by_chance("0.2", "0.25")
    others = [SamplingLaw.periodic(Exact("0.2")), lossy("0.2", 20), SamplingLaw("aperiodic", Exact(0), Exact(100)),
              by_chance("0.2", "0.24"), by_chance("0.2", "0.26"), by_chance("0.1", "0.25")]  # fmt: skip
    assert not any(one.contains(law) or law.contains(one) for one in others)
    assert law.contains(law) and not law.is_periodic and not law.is_bounded and not law.allows(Exact("0.2"))
    assert SamplingLaw.from_document(law.document()) == law and law.with_period(Exact(1)) == by_chance(1, "0.25")
    assert by_chance("0.2", 0) == SamplingLaw.periodic(Exact("0.2"))
    for wrong in ("0", "1", "-0.1"):
        with pytest.raises(ValueError, match="not a sampling law"):
            SamplingLaw.from_document({"period": "0.1", "probability": wrong})


@pytest.mark.parametrize("seed", range(10))
def test_linear_loops_lost_by_chance_against_the_mean_square(seed: int) -> None:
    """Proved below the probability at which rho = 1 and refuted above, within half a percent."""
    rng = np.random.default_rng(100 + seed)
    n = int(rng.integers(2, 4))
    while True:
        A = [[decimal_text(float(v), 3) for v in row] for row in rng.standard_normal((n, n)) * 0.7]
        K = [[decimal_text(float(v), 3)] for v in rng.uniform(-0.2, 1.0, n)]
        zero = [[0] * n for _ in range(n)]
        C = [[1] + [0] * (n - 1)]
        question = Question(impulsive(plant(A, zero, zero, C, by_chance("0.4", "0.01")), K), effort=2)
        if mean_radius(question, 0.01) < 0.99 and mean_radius(question, 0.97) > 1.01:
            break
    low, high = 0.01, 0.97
    while high - low > 1e-6:
        middle = (low + high) / 2
        low, high = (middle, high) if mean_radius(question, middle) < 1 else (low, middle)

    def at(p: float) -> Question:
        return question.under(by_chance("0.4", decimal_text(p, 6)))

    clock, lost = Clock.propose(at(low * 0.995)), Counterexample.propose(at(high * 1.005))
    assert clock is not None and clock.prove(at(low * 0.995)).holds
    assert lost is not None and lost.prove(at(high * 1.005)).holds
    assert Clock.propose(at(high * 1.005)) is None and Counterexample.propose(at(low * 0.995)) is None
    more = Clock(by_chance("0.4", decimal_text(high * 1.01, 6)), *(getattr(clock, f) for f in FIELDS))
    assert not more.prove(question).holds, "of more losses nothing is proved"
    assert clock.level(at(low * 0.995)) is None, "V falls in the mean only"


FIELDS = ("degree", "elevated", "pieces", "sigma", "basis", "P")


def test_a_certificate_without_losses_says_nothing_of_chance() -> None:
    question = Question(impulsive(canonical([1, 0], SamplingLaw.periodic(Exact("0.3"))), [["1"], ["0.7"]]), effort=1)
    clock = Clock.propose(question)
    assert clock is not None
    moved = Clock(by_chance("0.3", "0.9"), *(getattr(clock, f) for f in FIELDS))
    assert not moved.prove(question).holds and not clock.covers.contains(moved.law)


@pytest.mark.parametrize(("plant_of", "h", "least", "most"), [
    ("third order", "0.8", 0.475, 0.4756), ("pendulum", "0.3", 0.497, 0.5489), ("chain 3", "0.3", 0.42, 0.5489),
])  # fmt: skip
def test_the_probabilities_of_the_theory(plant_of: str, h: str, least: float, most: float) -> None:
    """Theory, measurement schemes, (c), independent losses."""
    third = plant([[0, 1, 0], [0, 0, 1], ["0.5", -1, "0.3"]], *([[[0] * 3] * 3] * 2), [[1, 0, 0]], by_chance(h, "0.2"))
    made_of = {"third order": third, "pendulum": canonical([1, 0], by_chance(h, "0.2")),
               "chain 3": canonical([1, 0, 0], by_chance(h, "0.2"))}[plant_of]  # fmt: skip
    question = Question(impulsive(made_of, [["0"]] * made_of.n), effort=2)

    def design(p: Exact) -> Any:
        return design_impulsive(question.under(by_chance(h, str(p))).afresh())

    met = search.between(design, Exact("0.2"), Exact("0.9"), Fraction(1, 2000), 6)
    assert met is not None
    p, (K, clock) = met
    about = question.under(by_chance(h, str(p))).with_gain({"K": K})
    assert float(p) >= least and clock.prove(about).holds
    end = every_gain_fails_from(about.inclusion)
    assert end is not None and float(p) < float(end) <= most
    assert Counterexample.propose(about.under(by_chance(h, str(most)))) is not None


def test_runs_lose_what_the_law_says_and_their_mean_square_falls(tmp_path: Path) -> None:
    text = PENDULUM.replace("period: 0.6}", "period: 0.2}\n  lost: {probability: 0.4}").replace("  method: set\n", "")
    text = text.replace("horizon: 6\n  initial_state: [1, 0]", "horizon: 40\n  initial_state: [1, 0]")
    result = made(tmp_path, text)
    assert result.status == "ok" and result.check is not None
    (claim,) = [claim for claim in result.check["claims"] if claim["id"] == "convergence"]
    assert "in mean square" in claim["statement"] and "lost with probability 0.4" in claim["statement"]
    with np.load(tmp_path / "out" / "simulation.npz") as arrays:
        gaps = np.diff(arrays["t_k"]) / 0.2
        error = arrays["x_hat"][-1] - arrays["x"][-1]
    assert np.allclose(gaps, np.round(gaps)) and 0.25 < 1 - len(gaps) / gaps.sum() < 0.55
    assert np.abs(error).max() < 1e-3
    assert "envelope" not in result.check


@pytest.mark.parametrize(
    ("period", "lost", "verdict"),
    [('"sqrt(2)/10"', "{at_most: 3}", "proved"), ("0.1", "{at_most: 20}", "undecided"),
     ("1e6", "{probability: 0.1}", "refuted"), ('"pi/30"', '{probability: "1/3"}', "proved"),
     ("0.1", "{probability: 0.9}", "refuted")],
)  # fmt: skip
def test_odd_numbers_are_answered(tmp_path: Path, period: str, lost: str, verdict: str) -> None:
    text = PENDULUM.replace("period: 0.6}", f"period: {period}}}\n  lost: {lost}").replace("  method: set\n", "")
    result = made(tmp_path, text, ("check",))
    assert result.check is not None and result.check["verdict"] == verdict
    if verdict == "undecided":
        assert "at T = 0.1;" in result.messages[0].text and "sampling.period" in str(result.messages[0])


def checked(folder: Path, dynamics: str, period: str, probability: str, gain: str) -> dict[str, Any]:
    states = "[x, v]" if "v" in dynamics else "[x]"
    text = (
        f"spec_version: 1\nplant: {{states: {states}, dynamics: {dynamics}, output: [x]}}\n"
        f"measurement: {{sampling: {{period: {period}}}, lost: {{probability: {probability}}}}}\n"
        f"observer: {{family: reachability, objective: given_period{gain}}}\n"
    )
    result = made(folder, text, ("check",))
    assert result.check is not None
    return result.check


def test_a_bracket_of_probabilities_never_contradicts_itself(tmp_path: Path) -> None:
    """With K = 4 a stable plant does worse with every sample than without: rho < 1 above 0.2 only."""
    check = checked(tmp_path, '["-x"]', "1", "0.1", ", gain: {K: [[4]]}")
    bound = check["bounds"]["loss_probability_max"]
    assert check["verdict"] == "refuted" and float(bound["proved"]) > 0.9 and bound["refuted"] is None
    dead_beat = checked(tmp_path, '["x"]', "1", "0.5", ", gain: {K: [[1]]}")["bounds"]["loss_probability_max"]
    assert float(dead_beat["proved"]) < np.exp(-2) < float(dead_beat["refuted"])
    assert float(dead_beat["refuted"]) - float(dead_beat["proved"]) < 5e-3


def test_irrational_periods_lost_by_chance_are_refuted_too(tmp_path: Path) -> None:
    assert checked(tmp_path, '["-x"]', '"sqrt(2)"', "0.1", ", gain: {K: [[6]]}")["verdict"] == "refuted"
    hidden = checked(tmp_path, '["v", "-4*x"]', '"pi/2"', "0.3", "")  # exp(A pi/2) = -I
    assert hidden["verdict"] == "refuted"


def test_a_probability_that_rounds_to_one_leaves_no_sample(tmp_path: Path) -> None:
    lost = '"0.99999999999999999999"'
    text = PENDULUM.replace("period: 0.6}", f"period: 0.2}}\n  lost: {{probability: {lost}}}")
    text = text.replace("  method: set\n", "").replace('["0", "sin(theta)"]', '["-theta", "-omega"]')
    text = text.replace("A: [[0, 1], [0, 0]]", "A: [[0, 0], [0, 0]]").replace("[[0, 0], [1, 0]]", "auto")
    result = made(tmp_path, text)
    assert result.simulation is not None and result.simulation["overall"]["measurements"] == 1


@pytest.mark.parametrize("law", [by_chance("0.5", "0.3"), lossy("0.5", 2)])
def test_that_every_constant_period_has_a_gain_says_nothing_of_losses(law: SamplingLaw) -> None:
    integrators = plant([[0, 1], [0, 0]], [[0, 0], [0, 0]], [[0, 0], [0, 0]], [[1, 0]], law)
    card = Reachability()
    design = designed(card, integrators, 0)
    more = Certificate("every_period", SamplingLaw.periodic(Exact("0.5")), {})
    for one in (design, replace(design, certificates=(*design.certificates, more))):
        check = card.certify(integrators, one, 0)
        assert check.verdict == "proved" and check.bounds["period_max_any_gain"].proved != "inf"
