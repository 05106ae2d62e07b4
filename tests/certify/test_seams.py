"""The two seams are real: a fifth family and a toy method come in without a line of the tool, and every method is asked
about every small plant."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from designing import designed
from example_inclusions import aperiodic, canonical, held, impulsive, periodic, plant
from fifth_family import Copy
from toy_method import MaximumNorm

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.falsify import refute
from cdobs_cli.certify.methods import named
from cdobs_cli.certify.methods.any_gain import NoGain
from cdobs_cli.certify.methods.base import Method, Question, read
from cdobs_cli.certify.methods.named import Known, loaded
from cdobs_cli.certify.methods.rung import GENERAL, One
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families import FAMILIES
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.pipeline import Work, check, simulate
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store

SPEC = """
spec_version: 1
plant:
  states: [theta, omega]
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)"]
  lipschitz: [[0, 0], [1, 0]]
measurement: {C: [[1, 0]], sampling: {period: 0.6}}
observer: {family: copy, objective: %s}
simulation: {horizon: 20, initial_state: [1, 0], initial_estimate: [0, 0]}
"""


class Measured(Copy):
    """The fifth family with the toy method as a rung of its ladder."""

    def methods(self) -> tuple[Known, ...]:
        return (MaximumNorm, *GENERAL.methods)

    def rungs(self, question: Question) -> tuple[Any, ...]:
        return (One(MaximumNorm), GENERAL)


def length(name: str) -> int:
    return len((Path(__file__).parent / name).read_text(encoding="utf-8").splitlines())


@pytest.mark.parametrize("objective", ["given_period", "max_period", "decay_rate"])
def test_a_fifth_family_is_designed_proved_and_simulated(
    objective: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert length("fifth_family.py") <= 100
    monkeypatch.setitem(FAMILIES, "copy", Copy)
    path = tmp_path / "copy.yaml"
    path.write_text(SPEC % objective)
    work = Work(load(path), Store(tmp_path / "results"), effort=0)
    made = check(work)
    assert made.verdict == "proved"
    bound = made.bounds["period_max"]
    assert float(bound.proved or 0) >= 0.6
    assert bound.refuted is None or float(bound.refuted) > float(bound.proved or 0)
    summary = simulate(work)
    assert summary is not None and not summary["overall"]["diverged"]


def test_a_toy_method_is_a_rung_of_the_ladder(tmp_path: Path) -> None:
    assert length("toy_method.py") <= 60
    small = plant([[0.1, 0], [0, 0.2]], [[0, 0], [-0.1, 0]], [[0, 0], [0.1, 0]], [[1, 0], [0, 1]], periodic("0.5"))
    card = Measured.model_validate({"family": "copy", "gain": {"K": ExactMatrix([["0.9", 0], [0, "0.9"]])}})
    design = designed(card, small, 0)
    assert {"maximum_norm", "clock"} <= {certificate.method for certificate in design.certificates}
    made = card.certify(small, design, 0)
    assert made.claim("maximum_norm").status == "proved"
    # |J| = 0.1, mu = 0.3: T < ln(10) / 0.3 = 7.675; the clock certificate does better.
    toy, best = (float(made.bounds[name].proved or 0) for name in ("period_max.maximum_norm", "period_max"))
    assert 7.5 < toy < 7.6753 and toy < best
    edited = [
        replace(one, data={**one.data, "mu": "0.2"}) if one.method == "maximum_norm" else one
        for one in design.certificates
    ]
    again = card.certify(small, replace(design, certificates=tuple(edited)), 0)
    assert again.claim("maximum_norm").status == "undecided" and "period_max.maximum_norm" not in again.bounds


IDENTITY = [["1", 0], [0, "1"]]
ZERO = [[0, 0], [0, 0]]
LINEAR = plant([[0, 1], [-1, "-0.1"]], ZERO, ZERO, [[1, 0]], periodic("0.5"))
SCALAR = plant([["0.3"]], [["-0.1"]], [["0.1"]], [["1"]], periodic("0.5"))
COUPLED = plant(
    [["-0.2", 1], [0, "-0.1"]], [["-0.1", 0], ["-0.3", 0]], [["0.1", 0], ["0.3", "0.1"]], [[1, 0]], periodic("0.4")
)
PLANTS = {
    "linear": LINEAR, "scalar": SCALAR, "pendulum": canonical([1, 0], periodic("0.5")), "coupled": COUPLED,
    "two_outputs": plant([[0, 1], [0, 0]], ZERO, [[0, 0], ["0.5", 0]], IDENTITY, periodic("0.5")),
    "chain3": canonical([1, 0, 0], periodic("0.3")),
    "undetectable": plant([["0.1", 0], [0, "0.2"]], ZERO, ZERO, [[1, 0]], periodic("0.5")),
    "unseen_class": plant([[0, 0], [0, "-1"]], [[0, 0], [0, 0]], [[0, 0], [0, 2]], [[1, 0]], periodic("0.5")),
    "pathological": plant([[0, 1], ["-9.869604401089358", 0]], ZERO, ZERO, [[1, 0]], periodic("1")),
    "nothing": plant([[0]], [[0]], [[0]], [[0]], periodic("1")),
}  # fmt: skip
LAWS = {"constant": None, "interval": ("0.1", "0.5"), "from_zero": ("0", "0.4")}
GAINS: dict[str, Any] = {
    "K": {1: [["0.8"]], 2: [["1"], ["0.6"]], 3: [["1"], ["1.2"], ["0.6"]]},
    "L": {1: [["0.9"]], 2: [["1"], ["0.6"]], 3: [["1.2"], ["0.9"], ["0.3"]]},
}
CARDS = {"K": Reachability(), "L": LpvZeroOrderHold()}


def questions() -> Iterator[tuple[str, str, Question]]:
    for name, one in PLANTS.items():
        for law, ends in LAWS.items():
            under = one if ends is None else replace(one, sampling=aperiodic(*ends))
            for letter, make in (("K", impulsive), ("L", held)):
                gain = GAINS[letter][one.n] if one.p == 1 else IDENTITY
                yield f"{name}-{law}-{letter}", letter, Question(make(under, gain), effort=0, card=CARDS[letter])


def methods(letter: str) -> tuple[type[Method], ...]:
    return tuple(loaded((*CARDS[letter].methods(), MaximumNorm)))


@pytest.mark.parametrize(("name", "letter", "question"), [pytest.param(*one, id=one[0]) for one in questions()])
def test_every_method_on_every_small_plant(name: str, letter: str, question: Question) -> None:
    proofs = []
    for method in methods(letter):
        if not method.applies(question):
            continue
        proposal = method.propose(question.afresh())
        if proposal is None:
            continue
        stored = Certificate.from_document(json.loads(json.dumps(proposal.certificate().document())))
        again = read(stored, methods(letter), (letter,))
        assert again is not None and again.gain is None and again.method == proposal
        proof = again.method.prove(question)
        assert proof.holds and again.method.covers.contains(question.law)
        worse = question.with_gain(
            {
                letter: ExactMatrix(
                    [[-9 if i == 0 else 0 for _ in range(question.plant.p)] for i in range(question.plant.n)]
                )
            }
        )
        if method.reach == "convergence":
            proofs.append(method.name)
            assert not again.method.prove(worse).holds or refute(worse.inclusion, 0) is None
        assert read(replace(stored, data={**stored.data, "stray": "1"}), methods(letter)) is None
    if proofs:
        assert unseen(question.plant) is None and refute(question.inclusion, 1) is None, proofs
        assert NoGain.propose(question) is None
    hopeless = ("undetectable", "unseen_class", "nothing")
    assert not (proofs and name.startswith(hopeless))


def test_methods_are_known_by_their_names() -> None:
    known = {*named.COMMON, *(one for card in CARDS.values() for one in card.methods())}
    assert {one.name: one.loaded().name for one in known if isinstance(one, named.Named)} == {
        one.name: one.name for one in known
    }
    for family, kind in FAMILIES.items():
        assert kind.model_fields["family"].default == family
