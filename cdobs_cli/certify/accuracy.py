"""Accuracy: how large the error stays under declared disturbance and noise, once for every family and for bounds of
either kind, of its largest value (`error.<state>`) and of its mean square (`rms.<state>`)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from flint import arb

from cdobs_cli.certificate import ERROR_BOUNDED, Bound, Claim, Witness, status_of
from cdobs_cli.certify.methods.base import UNREADABLE, Method, Proof, Question, Reach
from cdobs_cli.certify.methods.counterexample import Attained
from cdobs_cli.certify.methods.named import ACCURACY, Known, loaded
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text
from cdobs_cli.plant import Box, Plant
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.certify.gains import Merit
    from cdobs_cli.certify.levels import Level

REACHES: tuple[Reach, ...] = ("error bound", "mean square", "error attained")
Transient = Callable[[Box], tuple[arb, ...]]
DIGITS = 6
_ABOUT = "this gain under its law"


@dataclass(frozen=True)
class Sized:
    """A bound of the error that is proved: its name, how large, and by which certificate."""

    name: str
    error: arb
    method: Method


def sized(question: Question, methods: Iterable[Known] = ACCURACY) -> list[Sized]:
    """Of a gain under its law: of every name that these methods bound the least bound. Uses the solver."""
    known = question.law.is_bounded or question.law.has_sensors or question.law.is_on_change
    if not (is_sized(question.plant) and known) or question.inclusion.assemble_noise is None:
        return []
    least: dict[str, Sized] = {}
    for method, about in _asked(question.afresh(), methods):
        proposal = method.propose(about)
        if proposal is None:
            continue
        name, error = proposal.quantity(question.plant), proposal.prove(about).error
        if error is not None and (name not in least or error < least[name].error):
            least[name] = Sized(name, error, proposal)
    return list(least.values())


def is_sized(plant: Plant) -> bool:
    """Whether errors stay away from 0: under noise and disturbance, or because outputs are sent on change alone."""
    return plant.is_perturbed or plant.sampling.is_on_change


def of_states(question: Question) -> dict[str, arb]:
    """The least bound of each state's error that has one, by the states' names. Uses the solver."""
    return by_state(sized(question, [method for method in loaded(ACCURACY) if method.of_one_state]))


def by_state(sizes: Iterable[Sized]) -> dict[str, arb]:
    """The bounds that are about one state, by its name."""
    return {one.name.partition(".")[2]: one.error for one in sizes if "." in one.name}


def from_start(question: Question) -> list[Sized]:
    """The least bounds for all time from the question's start. Uses the solver."""
    return sized(question, [method for method in loaded(ACCURACY) if method.reach == "error bound"])


def merit(weights: Sequence[float]) -> Merit:
    """About how large the error of a question's gain stays under bounded signals: the weighted sum of the squares of
    what the solver says of each bound, nothing of it proved."""
    memory: dict[Any, Any] = {}  # rho and the corners that bind change little from gain to gain

    def of(question: Question) -> float | None:
        about = replace(question.with_effort(0), memory=memory)
        total = 0.0
        for i, weight in enumerate(weights):
            if weight:
                guesses = (method.error_guess(about.of_state(i)) for method in loaded(ACCURACY) if method.of_one_state)
                known = [guess for guess in guesses if guess is not None]
                if not known:
                    return None
                total += weight * min(known) ** 2
        return total

    return of


def _asked(question: Question, methods: Iterable[Known]) -> Iterator[tuple[type[Method], Question]]:
    """Every method with what it is asked: about each state, or about all of them."""
    for method in loaded(methods):
        if method.takes_law(question.law) and method.applies(question):
            states = range(question.plant.n) if method.of_one_state else ()
            yield from ((method, question.of_state(i)) for i in states)
            if not method.of_one_state:
                yield method, question


@dataclass(frozen=True)
class Item:
    """A stored certificate about the error's size, with what is proved of it."""

    method: Method
    proof: Proof


def accuracy(question: Question, items: Iterable[Item]) -> tuple[list[Claim], dict[str, Bound]]:
    """Claims and bounds of the design's gain under its law, from its certificates proved again. Loads no solver."""
    plant = question.plant
    if not is_sized(plant) or question.inclusion.assemble_noise is None:
        return [], {}
    claims, bounds = [], {}
    items = list(items)
    for name, named in _by_name(question, items).items():
        proved = [item for item in named if item.proof.holds and item.proof.error is not None]
        best = min(proved, key=_size, default=None)
        claims.append(_claim(name, best or named[0], question))
        if best is not None:
            about = ", ".join(filter(None, (_ABOUT, best.method.since(plant))))
            bounds[name] = Bound(upper_text(_error(best), DIGITS), None, "", best.method.rung, about, "less")
    bounds |= total(plant, bounds)
    reached, lower_ends = _reached(question, items)
    for name, end in lower_ends.items():
        bounds[name] = replace(bounds.get(name, Bound(None, None, "", None, _ABOUT, "less")), refuted=end)
    return [error_bounded(question, bounds), *claims, *reached], bounds


def total(plant: Plant, bounds: Mapping[str, Bound]) -> dict[str, Bound]:
    """`rms` of those of all states, where it is not bounded itself."""
    by_state = [bounds[f"rms.{state}"] for state in plant.states if f"rms.{state}" in bounds]
    if "rms" in bounds or len(by_state) < plant.n:
        return {}
    whole = sum((_end(one) ** 2 for one in by_state), arb(0)).sqrt()
    return {"rms": Bound(upper_text(whole, DIGITS), None, "", "sum of the states'", _ABOUT, "less")}


def _end(bound: Bound) -> arb:
    assert bound.proved is not None
    return Exact(bound.proved).ball()


def _by_name(question: Question, items: Iterable[Item]) -> dict[str, list[Item]]:
    """Those that are about the question's law and a bound that its plant has, by the names of the bounds."""
    named: dict[str, list[Item]] = {}
    for item in items:
        if item.method.reach != "error attained" and item.method.covers.contains(question.law):
            try:
                named.setdefault(item.method.quantity(question.plant), []).append(item)
            except UNREADABLE:
                continue
    return named


def _reached(question: Question, items: Iterable[Item]) -> tuple[list[Claim], dict[str, str]]:
    """How large errors become at least: claims with words that make them so, and lower ends by the bounds' names."""
    claims, ends = [], {}
    for item in items:
        method = item.method
        if not isinstance(method, Attained) or not item.proof.holds or method.law != question.law:
            continue
        state = question.plant.states[method.state]
        name, end = f"error.{state}", lower_text(_error(item), DIGITS)
        statement = f"|e_{state}| comes to {end} again and again for some slopes and signals of those declared"
        claims.append(
            Claim(
                f"{name}.reached", "certificate", "proved", f"{statement}, sampling {question.law.words}.",
                method.source, method=method.how, witness=Witness.from_document(method.witness),
            )
        )  # fmt: skip
        ends[name] = end
    return claims, ends


def transients(question: Question, items: Iterable[Item], levels: Sequence[Level]) -> list[Transient]:
    """From a box of errors before the first sample to upper ends of |e_j(t)| for all t after it, under the declared
    disturbance and noise.

    Of each state the least of: what is proved for all time from a box that holds this one; and, by superposition (the
    error system is linear under each V), the error without disturbance and noise plus the error from e = 0 under them.
    A bound of the latter in the long run is one at all times: before t = 0 it may be thought to have been 0 for ever.
    """
    known = _by_name(question, [item for item in items if item.proof.error is not None])

    def bounds(start: Box) -> tuple[arb, ...]:
        free, least = [level.bounds(start) for level in levels], []
        for i, state in enumerate(question.plant.states):
            from_start = [item for item in known.get(f"error_transient.{state}", ()) if item.method.holds_from(start)]
            ends = [_error(item) for item in from_start]
            ends += [_error(item) + level[i] for item in known.get(f"error.{state}", ()) for level in free]
            least.append(min((end.upper() for end in ends), key=float, default=arb.pos_inf()))
        return tuple(least)

    return [bounds] if known else []


def _error(item: Item) -> arb:
    assert item.proof.error is not None
    return item.proof.error


def _size(item: Item) -> float:
    return float(_error(item).upper())


def _claim(name: str, item: Item, question: Question) -> Claim:
    method, proof = item.method, item.proof
    told = method.statement if proof.error is None else f"{_left(name)} <= {upper_text(proof.error, DIGITS)}"
    since = method.since(question.plant)
    statement = f"{told}{f' {since}' if since else ''}, sampling {method.covers.words}."
    return Claim(name, "certificate", status_of(proof.holds), statement, method.source, method=method.how)


def _left(name: str) -> str:
    """`|e_theta|`, `rms(e_theta)`, `rms(e)`."""
    head, _, state = name.partition(".")
    if head == "rms":
        return f"rms(e_{state})" if state else "rms(e)"
    return f"|e_{state}|"


def error_bounded(question: Question, bounds: Mapping[str, Bound]) -> Claim:
    """Proved where every state has a proved bound, of its size where what acts is bounded, else of its mean square."""
    plant = question.plant
    names = [f"{'rms' if plant.has_white else 'error'}.{state}" for state in plant.states]
    under = f"Under {acting_text(plant)} the error stays bounded"
    law = f"sampling {question.law.words}"
    source = "cdobs, error bounds"
    if not all(name in bounds and bounds[name].proved is not None for name in names):
        return Claim(ERROR_BOUNDED, "consequence", "undecided", f"{under}, {law}.", source, required=True)
    told = ", ".join(f"{_left(name)} <= {bounds[name].proved}" for name in names)
    return Claim(
        ERROR_BOUNDED, "consequence", "proved", f"{under}: {told}, {law}.", source, required=True,
        method=bounds[names[0]].method, by=names[0],
    )  # fmt: skip


def acting_text(plant: Plant) -> str:
    """What acts on the error: `|v| <= 0.01, |d_omega| <= 0.05`, `noise of covariance [[1]]`."""
    outputs = ["v"] if plant.p == 1 else [f"v_{k + 1}" for k in range(plant.p)]
    told = [*_box_texts(plant.noise, outputs), *_box_texts(plant.disturbance, [f"d_{name}" for name in plant.states])]
    for what, matrix in (("covariance", plant.covariance), ("intensity", plant.intensity)):
        if matrix is not None:
            told.append(f"{'noise' if what == 'covariance' else 'a disturbance'} of {what} {_rows(matrix.texts())}")
    told += [f"|y - C x_hat| < {one.delta} ({one.name}) between messages" for one in plant.sampling.thresholds]
    return ", ".join(told) or "no disturbance and no noise"


def _rows(texts: list[list[str]]) -> str:
    return "[" + ", ".join("[" + ", ".join(row) + "]" for row in texts) + "]"


def _box_texts(box: Box | None, names: list[str]) -> Iterator[str]:
    if box is None:
        return
    for name, low, high in zip(names, box.lower, box.upper, strict=True):
        if low.sign() == high.sign() == 0:
            continue
        yield f"|{name}| <= {high}" if _opposite(low, high) else f"{name} in [{low}, {high}]"


def _opposite(low: Exact, high: Exact) -> bool:
    return low == -high or (low + high).sign() == 0
