"""What must not pass for an error bound: every inequality, corner and sign of the proofs, by a certificate that fails
nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from example_inclusions import aperiodic, canonical, periodic, plant
from flint import arb
from noisy_examples import asked, box, noisy, pendulum, sine
from test_output_slopes import seen_through

from cdobs_cli.certificate import ERROR_BOUNDED, UNDER_NOISE, Bound, Check, Claim
from cdobs_cli.certify.accuracy import Item, transients
from cdobs_cli.certify.conditions import proved_of_the_plant, with_conditions
from cdobs_cli.certify.levels import Level
from cdobs_cli.certify.methods.base import Proof, Question
from cdobs_cli.certify.methods.clock.certificate import split_basis
from cdobs_cli.certify.methods.peak.certificate import Peak
from cdobs_cli.certify.methods.peak.chain import Chain
from cdobs_cli.certify.methods.peak.from_zero import PeakFromZero
from cdobs_cli.certify.methods.peak.signals import Signals
from cdobs_cli.certify.methods.peak.split import split_error
from cdobs_cli.certify.methods.peak.start import first_vertices
from cdobs_cli.design import Confinement
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.families.reachability import Reachability
from cdobs_cli.hybrid import ErrorMaps
from cdobs_cli.plant import Box, Slopes

K = [["1"], ["1.47478"]]
KNOWN = pendulum("0.6", ("1", "1.47478"))
FROM_ZERO = pendulum(None, ("1", "1.2"), law=aperiodic(0, "0.6"))


def times(texts: Any, factor: str) -> Any:
    if isinstance(texts, str):
        return decimal_text((Exact(texts) * Exact(factor)).rational, 25)
    return [times(one, factor) for one in texts]


def scaled(chain: Chain, factor: str) -> Chain:
    """Every inequality but the target's is homogeneous."""
    return replace(chain, P=times(chain.P, factor), mu=times(chain.mu, factor), nu=times(chain.nu, factor))


def with_slopes(question: Question, low: str, high: str) -> Question:
    slopes = Slopes(ExactMatrix([[0, 0], [low, 0]]), ExactMatrix([[0, 0], [high, 0]]))
    made = replace(question.plant, slopes=slopes)
    return question.card.question(made, question.inclusion.gain, 1)


def test_the_error_is_below_its_function_and_every_corner_is_asked():
    chained, single = Peak.propose(KNOWN.of_state(1)), PeakFromZero.propose(FROM_ZERO.of_state(1))
    (chain,) = chained.chains
    for factor, holds in (("1.001", True), ("0.9", False)):
        assert replace(chained, chains=[scaled(chain, factor)]).prove(KNOWN).holds == holds
        other = replace(single, P=times(single.P, factor), mu=times(single.mu, factor), nu=times(single.nu, factor))
        assert other.prove(FROM_ZERO).holds == holds
    for method, question in ((chained, KNOWN), (single, FROM_ZERO)):
        assert method.prove(with_slopes(question, "-1", "1")).holds
        for low, high in (("-1", "1.1"), ("-1.1", "1")):
            assert not method.prove(with_slopes(question, low, high)).holds


def test_every_corner_of_the_jump_is_asked():
    law = periodic("0.4")

    def question(low: str, high: str) -> Question:
        made = seen_through(canonical(["0.3", "0"], law), [[low, 0]], [[high, 0]])
        # The same C in the middle: only the ends differ.
        return asked(Reachability(), noisy(made, [0, "0.05"], ["0.01"]), [["0.9"], ["1.2"]])

    method = Peak.propose(question("0.9", "1.1").of_state(1))
    assert method.prove(question("0.9", "1.1")).holds and method.prove(question("0.95", "1.1")).holds
    assert not method.prove(question("0.9", "1.3")).holds and not method.prove(question("0.7", "1.1")).holds


def test_windows_cover_all_times():
    question = sine("1", ("1.5299", "1.0428"))
    method = Peak.propose(question.of_state(0))
    whole = method.prove(question)
    assert replace(method, chains=method.chains[::-1]).prove(question).error.upper() == whole.error.upper()
    for chains in (method.chains[1:], method.chains[:-1], [*method.chains[:1], *method.chains[2:]], []):
        assert not replace(method, chains=chains).prove(question).holds


def form(rows: Any) -> Any:
    """The matrix of an upper triangle."""
    size = len(rows)
    return np.array([[float(rows[min(i, j)][abs(i - j)]) for j in range(size)] for i in range(size)])


def test_the_bound_of_a_chain_is_the_sum_of_its_docstring():
    """T = 0.1, from e(0) in a box: the second interval is the worst."""
    question, start = pendulum("0.1", ("0.5805", "1.2368")), box(["0.5", "1"])
    d0, v0, T = 0.05, 0.01, 0.1
    for about in (question.of_state(1), question.of_state(1).started(start)):
        method = Peak.propose(about)
        (chain,) = method.chains
        D = [sum(float(piece[0]) for piece in lag) * T / len(lag) * d0**2 for lag in chain.mu]
        *nu, tail = [float(lag[0]) * v0**2 for lag in chain.nu]
        N, rho2 = len(D) - 1, float(Exact(chain.rho)) ** 2
        terms = [(rho2 * D[N] + tail) / (1 - rho2) + sum(D) + sum(nu)]
        if about.start is not None:
            J = np.array([[1 - 0.5805, 0], [-1.2368, 1]])
            corners = [
                J @ [a, b] + np.array([0.5805, 1.2368]) * c for a in (-0.5, 0.5) for b in (-1, 1) for c in (-v0, v0)
            ]
            for q in range(N + 1):
                V = max(e @ form(chain.P[q][0]) @ e for e in corners)
                terms.append(V + sum(D[: q + 1]) + sum(nu[:q]))
            assert np.argmax(terms) == 2
        assert float(method.prove(question).error) == pytest.approx(max(terms) ** 0.5, rel=1e-9)


def test_the_bound_from_zero_is_that_of_its_docstring():
    start = box(["0.3", "0.2"])
    for about in (FROM_ZERO.of_state(1), FROM_ZERO.of_state(1).started(start)):
        method = PeakFromZero.propose(about)
        split = split_error(FROM_ZERO, Matrix.from_rows(split_basis(FROM_ZERO.inclusion)))
        s0 = float(split.s0[0])
        c = max(float(mu[0]) * s0**2 + float(mu[1]) * 0.05**2 for mu in method.mu)
        largest = c / (2 * float(Exact(method.sigma)))
        if about.start is not None:
            S, P = split.S.floats, form(method.P[0])[:2, :2]
            J = np.eye(2) - np.outer([1, 1.2], [1, 0])
            x = [np.linalg.solve(S, J @ [a, b]) for a in (-0.3, 0.3) for b in (-0.2, 0.2)]
            started = max(one @ P @ one for one in x)
            assert started > 1.5 * largest or started == pytest.approx(largest, rel=1e-4)
            largest = max(largest, started)
        error = (largest + float(method.nu[0]) * s0**2) ** 0.5
        assert float(method.prove(FROM_ZERO).error) == pytest.approx(max(error, 0.2 * bool(about.start)), rel=1e-9)


def test_how_a_function_begins_is_exact():
    method = PeakFromZero.propose(FROM_ZERO.of_state(1))
    tiny = "1e-15"  # every other inequality has room for it
    for at, k in ((0, 1), (0, 2), (1, 1), (2, 0)):  # kept and lost; on s
        P_0 = [list(row) for row in method.P[0]]
        assert P_0[at][k] == "0"
        P_0[at][k] = tiny
        assert not replace(method, P=[P_0, *method.P[1:]]).prove(FROM_ZERO).holds
        P_1 = [list(row) for row in method.P[1]]
        P_1[at][k] = decimal_text((Exact(P_1[at][k]) + Exact(tiny)).rational, 30)
        assert replace(method, P=[method.P[0], P_1, *method.P[2:]]).prove(FROM_ZERO).holds


@pytest.mark.parametrize(("law", "A", "P"), [(("0.05", "0.1"), "-1", ("1", "1")), ((0, "0.1"), "-100", ("1", "5"))])
def test_a_jump_that_grows_is_no_bound(law, A, P):
    """edot = A e + d, e+ = -2 e: samples that follow fast make e grow, and all but the jump at some tau is right."""
    made = noisy(plant([[A]], [[0]], [[0]], [[1]], aperiodic(*law)), ["1"], None)
    grows, stays = (asked(Reachability(), made, [[k]]) for k in ("3", "0.5"))
    pieces = ["0", "1"] if law[0] == 0 else ["1", "1"]
    coefficients = list(P) if law[0] == 0 else [*P, P[1]]
    method = PeakFromZero(
        made.sampling, "0", "1", "1", pieces, "0.5", [["1"]], [[["1.01"]] if p == "1" else [[p]] for p in coefficients],
        [["100"]] * (len(coefficients) - 1), [],
    )  # fmt: skip
    assert not method.prove(grows).holds
    if law[0] == 0:
        assert method.prove(stays).holds


def test_noise_that_samples_keep_is_not_shifted():
    """The second output reads nothing, and its noise is added to e_2 at every sample."""
    zero = [[0, 0], [0, 0]]
    made = plant([["-1", 0], [0, "-1"]], zero, zero, [[1, 0], [0, 0]], aperiodic(0, "0.1"))
    question = asked(Reachability(), noisy(made, None, ["0.1", "0.1"]), [["1", 0], [0, "1"]])
    assert split_error(question, Matrix.identity(2)) is None
    assert PeakFromZero.propose(question.of_state(1)) is None
    quiet = asked(Reachability(), noisy(made, None, ["0.1", 0]), [["1", 0], [0, "1"]])
    assert split_error(quiet, Matrix.from_rows([[0, 1], [1, 0]])) is not None


def test_a_start_takes_both_signs_of_noise_and_no_state_that_outlives_the_sample():
    maps = ErrorMaps(Matrix.zeros(2, 2), (), (), (), Matrix.from_rows([[1, 0], [0, 0]]))
    signals = Signals(Matrix.zeros(2, 0), Matrix.from_rows([[0], [1]]), (), (Exact("0.5").scalar,))
    one = Box((Exact("-1"),), (Exact("2"),))
    met = {tuple(float(row[0]) for row in e.tolist()) for e in first_vertices(maps, signals, one)}
    assert met == {(a, b) for a in (-1.0, 2.0) for b in (-0.5, 0.5)}
    kept = replace(maps, jump=Matrix.from_rows([[1, 1], [0, 0]]))
    assert first_vertices(kept, signals, one) is None
    many = replace(maps, jump=Matrix.identity(11))
    assert first_vertices(many, signals, Box((Exact(0),) * 11, (Exact(1),) * 11)) is None


def test_the_larger_end_of_a_box_counts():
    for low, high in (("-0.002", "0.01"), ("-0.01", "0.002")):
        made = replace(KNOWN.plant, noise=Box((Exact(low),), (Exact(high),)))
        question = asked(Reachability(), made, K)
        method = Peak.propose(KNOWN.of_state(1))
        assert method.prove(question).error.upper() == method.prove(KNOWN).error.upper()


def test_held_innovations_are_asked_in_every_window():
    question = asked(LpvZeroOrderHold(), sine("1", ("1.5299", "1.0428")).plant, [["1.5299"], ["1.0428"]])
    method = Peak.propose(question.of_state(0))
    chains = [scaled(chain, "0.9") if k == 2 else chain for k, chain in enumerate(method.chains)]
    worst = replace(method, chains=chains)
    assert not worst.prove(question).holds


# What is made of bounds.


class Known:
    """A certificate that says what it is told."""

    reach = "error bound"

    def __init__(self, name: str, start: Box | None = None) -> None:
        self.name, self.start, self.covers = name, start, KNOWN.law

    def quantity(self, _: Any) -> str:
        return self.name

    def holds_from(self, start: Box) -> bool:
        return start == self.start


def test_a_transient_under_noise_is_the_sum_or_what_is_proved_of_it():
    level = Level((Matrix.identity(2),), (arb(1), arb(4)))
    items = [Item(Known(f"error.x{i}"), Proof(True, error=arb(0.5))) for i in range(2)]
    start, other = box(["3", "4"]), box(["0", "1"])
    (bounds,) = transients(KNOWN, items, [level])
    assert [float(end) for end in bounds(start)] == [5.5, 10.5] and [float(end) for end in bounds(other)] == [1.5, 2.5]
    items.append(Item(Known("error_transient.x0", start), Proof(True, error=arb(2))))
    (bounds,) = transients(KNOWN, items, [level])
    assert [float(end) for end in bounds(start)] == [2, 10.5] and float(bounds(other)[0]) == 1.5
    (alone,) = transients(KNOWN, items, [])
    assert float(alone(start)[0]) == 2 and float(alone(other)[0]) == float("inf")
    assert transients(KNOWN, [Item(Known("error.x0"), Proof(False))], [level]) == []
    elsewhere = Known("error.x0")
    elsewhere.covers = periodic("0.5")
    assert transients(KNOWN, [Item(elsewhere, Proof(True, error=arb(1)))], [level]) == []


@pytest.mark.parametrize(
    ("way", "held", "holds"), [("margin", False, False), ("margin", True, True), ("open", True, True)]
)
def test_a_margin_without_noise_holds_no_error_bound(way, held, holds):
    made = replace(KNOWN.plant)
    claims = [
        Claim("convergence", "consequence", "proved", "It converges.", "", required=True),
        Claim(ERROR_BOUNDED, "consequence", "proved", "It stays bounded.", "", required=True),
    ]
    confinement = (
        Confinement(way, {"x0": "1", "x1": "1"}, (("0", "0"), ("0", "0"))) if way == "margin" else Confinement(way)
    )
    claims.append(Claim(UNDER_NOISE, "certificate", "proved" if held else "undecided", "it stays", ""))
    told = with_conditions(claims, made, confinement, made.domain, disturbed=False)
    bounded = next(claim for claim in told if claim.id == ERROR_BOUNDED)
    assert (bounded.status == "proved") == holds
    check = Check(tuple(told), {"error.x0": Bound("1", "0.5", better="less"), "rms.x0": Bound("1", None)})
    kept = proved_of_the_plant(check, made.sampling, confinement)
    assert (kept["error.x0"].proved is not None) == holds and kept["error.x0"].refuted == "0.5"
    assert ("rms.x0" in kept) == holds
