"""The verbs of the family: designs and their guaranteed periods, checks, the observer in simulation, c(x_hat, u)."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from updated_plants import burst, chain, last_row, sines

from cdobs_cli.certificate import Check
from cdobs_cli.certify.methods.base import read
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.updated_sampling import UpdatedSampling
from cdobs_cli.families.updated_sampling.lipschitz import constant_rate, derive_rate, magnitudes, rate_claim, typed_rate
from cdobs_cli.families.updated_sampling.member import asked
from cdobs_cli.families.updated_sampling.separated import modulus_bound, separated
from cdobs_cli.families.updated_sampling.structure import problems
from cdobs_cli.families.updated_sampling.synthesis import THEOREMS
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Domain, Interval, Plant
from cdobs_cli.run import Run, SimulationPlan
from cdobs_cli.simulate.engine import simulate


def family(**options: object) -> UpdatedSampling:
    return UpdatedSampling.model_validate({"family": "updated_sampling", **options})


def given(K: list[str], alpha: str, a1: str, a2: str, a3: str = "0") -> dict[str, object]:
    return {"K": [[entry] for entry in K], "alpha": alpha, "a1": a1, "a2": a2, "a3": a3}


def designed(card: UpdatedSampling, plant: Plant, effort: int = 0) -> tuple[Design, Check]:
    design = card.synthesize(plant, effort)
    return design, card.certify(plant, design, effort)


def period(check: Check) -> float:
    return float(check.bounds["guaranteed_period"].proved or 0)


@pytest.fixture(scope="module")
def two_states() -> tuple[Design, Check]:
    return designed(family(), sines(2))


def test_two_states(two_states):
    design, check = two_states
    assert check.verdict == "proved"
    assert period(check) >= 0.105
    assert {claim.id for claim in check.claims if claim.required} == {"convergence"}
    bound = check.bounds["guaranteed_period"]
    assert bound.refuted is not None and period(check) <= float(bound.refuted) <= period(check) * (1 + 1e-6)
    assert float(check.bounds["guaranteed_period.lemma_1"].proved or 1) < period(check) / 10
    assert Design.from_document(design.document()) == replace(design)


@pytest.mark.parametrize(("n", "least"), [(3, 0.030), (4, 0.012)])
def test_more_states(n, least):
    design, check = designed(family(), sines(n))
    assert check.verdict == "proved"
    assert period(check) >= least
    assert design.gain["K"].shape == (n, 1)


def test_a_constant_period_does_more_where_c_is_known(two_states):
    design, check = two_states
    constant = check.bounds["guaranteed_period.constant"]
    assert float(constant.proved or 0) > 3 * period(check)
    certificate = design.certificates[-1]
    assert certificate.method == "constant_period"
    for data in ({**certificate.data, "c": "0.5"}, {**certificate.data, "K": [["1"], ["-1"]]}, {}):
        changed = (*design.certificates[:-1], replace(certificate, data=data))
        again = family().certify(sines(2), replace(design, certificates=changed), 0)
        assert again.verdict == "proved"
        assert again.claim("constant_period").status == "undecided"
        assert "guaranteed_period.constant" not in again.bounds


def test_large_c():
    _, check = designed(family(), sines(2, "100"))
    assert check.verdict == "proved"
    assert 100 * period(check) >= 0.17


@pytest.mark.parametrize("c", ["1e-6", "1e6"])
def test_extreme_c(c):
    _, check = designed(family(), sines(2, c))
    assert check.verdict == "proved"


def test_the_constants_of_the_paper():
    design, check = designed(family(method="theorem_2"), sines(2))
    assert check.verdict == "proved"
    assert 9e-4 <= period(check) < 0.01
    conditions = {claim.id: claim.status for claim in check.claims if claim.id.startswith("theorem_2.")}
    names = ("8", "9", "a_1", "alpha_m", "a_2", "a_3")
    assert conditions == dict.fromkeys((f"theorem_2.{name}" for name in names), "proved")
    for name, factor in (("a2", "0.9"), ("a3", "0.9"), ("a1", "1.1"), ("alpha", "1.5")):
        shifted = ExactMatrix([[Exact(factor) * design.gain[name][0, 0]]])
        changed = replace(design, gain={**design.gain, name: shifted})
        assert family(method="theorem_2").certify(sines(2), changed, 0).verdict == "undecided"


def test_last_row_is_less_conservative(two_states):
    card = family(variant="last_row")
    _, check = designed(card, last_row(2))
    assert check.verdict == "proved"
    assert period(check) > 1.3 * period(two_states[1])


def test_given_alpha():
    design, check = designed(family(objective="given_alpha", alpha="1"), sines(2))
    assert check.verdict == "proved"
    assert design.gain["alpha"][0, 0] == Exact(1)


def test_a_changed_gain_or_certificate_is_not_proved(two_states):
    design, _ = two_states
    card, plant = family(), sines(2)
    for name, factor in (("a2", "0.99"), ("a1", "1.05")):
        shifted = ExactMatrix([[Exact(factor) * design.gain[name][0, 0]]])
        assert card.certify(plant, replace(design, gain={**design.gain, name: shifted}), 0).verdict == "undecided"
    certificate = design.certificates[0]
    for data in ({"P": [["1", "2"], ["2", "1"]], "p_3": "1.9"}, {**certificate.data, "p_3": "2.1"}, {"P": [["1"]]}, {}):
        changed = replace(design, certificates=(replace(certificate, data=data),))
        assert card.certify(plant, changed, 0).verdict == "undecided"
    assert card.certify(plant, replace(design, details={}), 0).verdict == "undecided"


@pytest.mark.parametrize("method", ["theorem_2_prime", "theorem_2"])
def test_a_theorem_is_its_certificate(method):
    card, plant = family(method=method), sines(2)
    design = card.synthesize(plant, 0)
    stored = read(design.certificates[0], THEOREMS)
    assert stored is not None and stored.gain is None
    assert stored.method.name == method and stored.method.certificate() == design.certificates[0]
    question = asked(card, plant, design.gain, 0)
    proof = stored.method.prove(question)
    claims = stored.method.claims(question, proof)
    assert proof.holds and claims and all(claim.status == "proved" for claim in claims)
    slow = {**design.gain, "a2": ExactMatrix([[Exact("0.5") * design.gain["a2"][0, 0]]])}
    weaker = stored.method.prove(question.with_gain(slow))
    assert not weaker.holds
    assert "undecided" in {claim.status for claim in stored.method.claims(question, weaker)}
    data = {**design.certificates[0].data, "mu": "1"}
    assert read(replace(design.certificates[0], data=data), THEOREMS) is None


def test_a_design_for_smaller_slopes_does_not_serve_larger_ones(two_states):
    design, _ = two_states
    assert family().certify(sines(2, "2"), design, 0).verdict == "undecided"


@pytest.mark.parametrize(
    ("K", "alpha", "hurwitz", "one_step"),
    [
        (["-2", "1"], "0.9", "refuted", "refuted"),
        (["-2", "-1"], "0.9", "proved", "refuted"),
        (["-2", "-1"], "0.5", "proved", "proved"),
        (["-1", "-1/4"], "0.9", "proved", "proved"),
    ],
)
def test_the_printed_gain_and_its_repairs(K, alpha, hurwitz, one_step):
    _, check = designed(family(gain=given(K, alpha, "1", "0.1", "0.1")), sines(2))
    claims = {claim.id: claim for claim in check.claims}
    assert (claims["hurwitz"].status, claims["one_step_map"].status) == (hurwitz, one_step)
    assert check.verdict == ("refuted" if one_step == "refuted" else "undecided")
    if hurwitz == "refuted":
        witness = claims["hurwitz"].witness
        assert witness is not None and float(witness.multiplier or 0) == pytest.approx(2**0.5 - 1, abs=1e-5)
        v = np.array([float(entry) for entry in witness.values[0]])
        closed = np.array([[-2.0, 1.0], [1.0, 0.0]])
        assert closed @ v == pytest.approx((2**0.5 - 1) * v, abs=1e-6)
    if one_step == "refuted":
        witness = claims["convergence"].witness
        assert witness is not None and witness.about == "class"
        assert float(witness.multiplier or 0) >= 1.2499


def test_a_given_gain_that_meets_the_theorem():
    found, _ = designed(family(), sines(2))
    texts = {name: matrix.texts() for name, matrix in found.gain.items()}
    gain = {"K": texts["K"]} | {name: texts[name][0][0] for name in ("alpha", "a1", "a3")} | {"a2": "4"}
    design, check = designed(family(gain=gain), sines(2))
    assert design.outcome == "given"
    assert check.verdict == "proved"


def test_irrational_numbers_of_a_given_gain():
    _, check = designed(family(gain=given(["sqrt(2)-3", "-2"], "sqrt(2)/3", "0.3", "5")), sines(2))
    assert check.verdict == "proved"
    assert check.claim("hurwitz").status == "proved"


def run(
    plant: Plant,
    design: Design,
    card: UpdatedSampling,
    horizon: str,
    start: tuple[str, ...],
    signals: dict[str, str],
) -> Run:
    plan = SimulationPlan(
        Exact(horizon), tuple(Exact(value) for value in start), initial_estimate=tuple(Exact(0) for _ in start),
        signals={name: parse(text, frozenset({"t"})) for name, text in signals.items()},
    )  # fmt: skip
    return simulate(HybridSystem(plant, card.observer(plant, design)), plan, plant.sampling)


def test_the_trigger_and_the_decay_along_a_run(two_states):
    design, check = two_states
    plant = sines(2)
    made = run(plant, design, family(), "4", ("1", "-1"), {})
    trajectory = made.trajectories[0]
    delta = np.diff(trajectory.t_k)
    assert delta.min() >= period(check) * (1 - 1e-9)
    before = np.searchsorted(trajectory.t, trajectory.t_k[1:], side="left")
    assert delta * trajectory.internals["L"][before] == pytest.approx(float(design.gain["alpha"][0, 0]), rel=1e-11)
    # V = E'PE falls at every sample, by the proved factor at least.
    P = ExactMatrix(design.certificates[0].data["P"]).floats
    after = np.searchsorted(trajectory.t, trajectory.t_k, side="right") - 1
    L = trajectory.internals["L"][after][:, None]
    E = (trajectory.estimates["x_hat"][after] - trajectory.x[after]) / L ** np.arange(1, 3)
    V = np.einsum("ki,ij,kj->k", E, P, E)
    factor = 1 - float(check.claim("theorem_2_prime.i").margin)
    kept = V[:-1] > 1e-22
    assert np.all(V[1:][kept] <= factor * V[:-1][kept])


def test_an_unbounded_c_stops_with_a_sentence():
    plant = chain(2, ["0", "sin(x1)"], [["0", "0"], ["1", "0"]])
    card = family(c="1 + x2**4", gain=given(["-2", "-1"], "0.5", "0.5", "5"))
    design, check = designed(card, plant)
    assert check.verdict == "undecided"
    assert check.claim("c_bounded").status == "undecided"
    made = run(plant, design, card, "40", ("1", "200"), {})
    assert made.overall.stopped is not None and "1e6" in made.overall.stopped


def test_no_bound_of_c_is_a_finding():
    plant = chain(2, ["0", "sin(x1)"], [["0", "0"], ["1", "0"]])
    design = family(c="1 + x2**2").synthesize(plant, 0)
    assert design.outcome == "none" and "domain" in (design.reason or "")


def test_c_is_derived_from_the_nonlinearity():
    rate = derive_rate(burst(), "triangular")
    assert rate.origin == "derived"
    assert str(rate.c) == "min(abs(u), 10)"
    assert rate_claim(burst(), rate, "triangular").status == "proved"
    flat = derive_rate(sines(2), "triangular")
    assert (flat.origin, str(flat.c)) == ("constant", "1")


def test_a_typed_c_is_proved_or_left_open():
    for text, status in (("1.01*u", "proved"), ("0.9*u", "undecided"), ("10", "proved"), ("5", "undecided")):
        rate = typed_rate(burst(), parse(text, frozenset({"u"})))
        assert rate_claim(burst(), rate, "triangular").status == status


def test_a_smaller_stored_c_is_not_believed():
    rate = derive_rate(burst(), "triangular")
    assert rate_claim(burst(), replace(rate, c=parse("u/2", frozenset({"u"}))), "triangular").status == "undecided"
    values = magnitudes(sines(2))
    assert values is not None
    constant = constant_rate("triangular", values)
    smaller = replace(constant, c=parse("0.5"), largest=Exact("0.5"))
    assert rate_claim(sines(2), smaller, "triangular").status == "undecided"


def test_secants_bound_differences_by_brute_force():
    domain = Domain({"x1": Interval(Exact("0.5"), Exact(1)), "x2": Interval(Exact(0), Exact(2))})
    plant = chain(2, ["0", "u*x2**2/x1"], [["0", "0"], ["32", "16"]], {"u": ("0.1", "2")}, domain)
    rate = derive_rate(plant, "triangular")
    assert rate_claim(plant, rate, "triangular").status == "proved"
    rng = np.random.default_rng(5)
    for _ in range(500):
        x, h, u = rng.uniform([0.5, 0], [1, 2]), rng.uniform([0.5, 0], [1, 2]), rng.uniform(0.1, 2)
        difference = abs(u * h[1] ** 2 / h[0] - u * x[1] ** 2 / x[0])
        c = float(rate.c.ball({"x1": _arb(h[0]), "x2": _arb(h[1]), "u": _arb(u)}))
        assert difference <= c * np.abs(h - x).sum() + 1e-12


def _arb(value: float) -> object:
    from flint import arb

    return arb(float(value))


def test_separated_sums():
    names = frozenset({"x", "h", "u"})
    terms = separated(parse("(x + h)**2*u + sin(x)/h", names), frozenset({"h", "u"}))
    assert terms is not None
    total = parse("0")
    for m, a in terms.items():
        total = total + m * a
    point = {"x": _arb(0.3), "h": _arb(0.7), "u": _arb(1.1)}
    assert float(total.ball(point)) == pytest.approx((0.3 + 0.7) ** 2 * 1.1 + np.sin(0.3) / 0.7)
    assert separated(parse("sin(x*h)", names), frozenset({"h", "u"})) is None
    bound = modulus_bound({parse("h", names): parse("x", names)}, lambda a: (Exact(-1), Exact(3)))
    assert bound is not None and float(bound.ball({"h": _arb(-2.0)})) == pytest.approx(6.0)


def test_structure_is_judged_by_validate():
    upper = chain(2, ["sin(x2)", "0"], [["0", "1"], ["0", "0"]])
    assert [one.path for one in problems(family(), upper)] == ["plant.lipschitz[0][1]"]
    assert [one.path for one in problems(family(variant="last_row"), sines(2))] == ["plant.lipschitz[0][0]"]
    assert problems(family(), sines(7))[0].path == "plant.states"
    assert problems(family(objective="given_alpha"), sines(2))[0].path == "observer.alpha"
    wrong = family(gain=given(["1", "2", "3"], "1", "1", "1"))
    assert [one.path for one in problems(wrong, sines(2))] == ["observer.gain.K", "observer.gain.a1"]
    assert problems(family(), sines(6)) == []


def test_one_state_and_a_linear_plant():
    _, check = designed(family(), chain(1, ["sin(x1)"], [["1"]]))
    assert check.verdict == "proved"
    _, check = designed(family(), chain(2, ["0", "0"], [["0", "0"], ["0", "0"]]))
    assert check.verdict == "proved"


def test_check_loads_no_solver(two_states):
    script = (
        "import json, sys; from updated_plants import sines; from cdobs_cli.design import Design;"
        "from cdobs_cli.families.updated_sampling import UpdatedSampling;"
        "design = Design.from_document(json.loads(sys.stdin.read()));"
        "assert UpdatedSampling().certify(sines(2), design, 0).verdict == 'proved';"
        "assert not {'cvxpy', 'clarabel', 'scipy', 'matplotlib'} & set(sys.modules)"
    )
    import json
    from pathlib import Path

    here = Path(__file__).parent
    made = subprocess.run(
        [sys.executable, "-c", script], input=json.dumps(two_states[0].document()), text=True, capture_output=True,
        check=False, timeout=60,
        cwd=here.parents[2], env={"PYTHONPATH": f"{here}:{here.parents[2]}"},
    )  # fmt: skip
    assert made.returncode == 0, made.stderr
