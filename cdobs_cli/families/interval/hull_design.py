"""S and L for the hull predictor: where |S F(s) S^-1| contracts for every period of the law, no positivity asked.

Searched in floats over all entries of S and L; the majorant

    max over s of (|S F(s) S^-1| - I)/s,  entry by entry,

is a Metzler matrix, and contraction in one weighted norm follows from its abscissa being negative.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from typing import Any

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.certify import search
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.interval.design import S_DIGITS, Search, climb
from cdobs_cli.families.interval.held import held_maps
from cdobs_cli.families.interval.hull import Hull
from cdobs_cli.families.interval.method import Gain
from cdobs_cli.families.interval.system import singular
from cdobs_cli.sampling import SamplingLaw

_WIDTH, _DIGITS = Fraction(1, 30), 4
_USED = 0.98  # share of a gain's longest period that is used: at the limit itself the radius takes for ever to settle
_SHORTEST = 1e-3  # of the largest period: where the grid of the search begins
_CONDITION = 1e5
_BEFORE = "hull design"  # in the memory of a question: the entries of S and L found last


def hull_design(card: Question, searched: Search) -> tuple[Gain, SamplingLaw, dict[str, Any]] | str:
    """Gain, law and details for the objective; or why there is none.

    `max_period` searches on from period to period while a contraction is found; the other objectives take the
    fastest contraction at the given one.
    """
    design = _at(card, searched)
    if design is None:
        return f"no S and L were found for which the hull predictor contracts for periods up to {card.law.T_max}"
    if card.card.objective != "max_period":
        return *design, {}
    gain, law = search.longest(lambda T: _at(card.at(T), searched), card.law.T_max, _WIDTH, digits=_DIGITS) or design
    hull = Hull.longest(card.with_gain(gain).under(law))
    used = law if hull is None else law.with_period(search.short(_USED * float(hull.law.T_max), _DIGITS))
    return gain, max(law, used, key=lambda one: float(one.T_max)), {}


def _at(question: Question, searched: Search) -> tuple[Gain, SamplingLaw] | None:
    """A gain at the question's law, proved."""
    n, p, law, effort = question.plant.n, question.plant.p, question.law, question.effort
    high = float(law.T_max)
    periods = np.array([high]) if law.is_periodic else np.linspace(max(float(law.T_min), _SHORTEST * high), high, 17)

    def parts(parameters: Array) -> tuple[Array, Array] | None:
        S = parameters[: n * n].reshape(n, n)
        lengths = np.linalg.norm(S, axis=1, keepdims=True)
        if not np.all(np.isfinite(parameters)) or not np.all(lengths > 0) or np.linalg.cond(S / lengths) > _CONDITION:
            return None
        return S / lengths, parameters[n * n :].reshape(n, p)

    def value(parameters: Array) -> float:
        pair = parts(parameters)
        maps = None if pair is None else held_maps(searched.A, -pair[1] @ searched.C, periods)
        if pair is None or maps is None:
            return -np.inf
        moduli = np.abs(pair[0] @ maps @ np.linalg.inv(pair[0]))
        majorant = np.max((moduli - np.eye(n)) / periods[:, None, None], axis=0)
        return -float(np.linalg.eigvals(majorant).real.max())

    fresh = sorted(_starts(searched, high, effort), key=value, reverse=True)[: 1 + (4 if n <= 2 else 1) * effort]
    for start in [*question.memory.get(_BEFORE, []), *fresh]:
        parameters, rate = climb(value, [start], 0.3, effort + 1)
        if rate > 0:
            break
    pair = parts(parameters)
    if pair is None or not rate > 0:
        return None
    gain = {name: ExactMatrix.from_floats(floats, S_DIGITS) for name, floats in zip(("S", "L"), pair, strict=True)}
    if singular(gain["S"]) is not None or Hull.propose(question.with_gain(gain)) is None:
        return None
    question.memory[_BEFORE] = [parameters]
    return gain, law


def _starts(searched: Search, high: float, effort: int) -> Iterator[Array]:
    """S from the Sylvester equation and at random (always the same), with injections of several strengths."""
    n = len(searched.A)
    random = np.random.default_rng(0)
    shapes = [shape.S for shape in (searched.shape(start) for start in searched.starts()) if shape is not None]
    shapes += [random.normal(size=(n, n)) for _ in range(8 * (1 + effort))]
    for S in shapes:
        S = S / np.linalg.norm(S, axis=1, keepdims=True)
        for rate in (0.3 / high, 1 / high):
            yield np.concatenate([S.reshape(-1), rate * np.linalg.pinv(searched.C).reshape(-1)])
