"""What `validate` sees of a carried certificate: outputs, options that go together, shapes of typed constants."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

from cdobs_cli.errors import Problem
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.families.updated_sampling.carried.law import MATRICES, NUMBERS
from cdobs_cli.families.updated_sampling.carried.typed import is_whole
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

MAX_STATES = 6


def problems(family: UpdatedSampling, plant: Plant) -> list[Problem]:
    """Mistakes that show without linear algebra."""
    return [*_of_plant(plant), *_of_options(family, plant), *_of_law(family, plant)]


def _of_plant(plant: Plant) -> Iterator[Problem]:
    if not plant.sampling.is_updated:
        what, kind = "this observer chooses its sampling instants", plant.sampling.kind
        yield Problem(("measurement", "sampling"), what, got=kind, allowed="{updated: true}")
    if plant.n > MAX_STATES:
        what, allowed = "too many states for this family", f"1 to {MAX_STATES}"
        yield Problem(("plant", "states"), what, got=str(plant.n), allowed=allowed)
    if plant.output_quantities:
        what, hint = "this observer takes outputs that are linear in the states", "family reachability takes any output"
        k = plant.output_quantities[0].entry[0]
        yield Problem(("plant", "output", k), what, got=str((plant.h or ())[k]), hint=hint)
    if plant.intensity is not None:
        what, hint = "a white disturbance has no bound here", "bound it: {lower: [..], upper: [..]}"
        yield Problem(("plant", "disturbance"), what, hint=hint)


def _of_options(family: UpdatedSampling, plant: Plant) -> Iterator[Problem]:
    if family.gain is not None:
        hint = "leave it out: its gain follows from Pi; law types the constants of the certificate"
        yield Problem(("observer", "gain"), "a carried certificate has no gain of its own", hint=hint)
    if family.objective == "given_alpha" or family.alpha is not None:
        what, allowed = "a carried certificate has no alpha", "max_period, min_error"
        yield Problem(("observer", "objective"), what, family.objective, allowed)
    if family.variant != "triangular":
        what = "is of the theorems: a carried certificate takes any slopes"
        yield Problem(("observer", "variant"), what, family.variant)
    rule, law = family.rule, family.law
    if rule is not None and (rule.trigger == "integral") != (rule.kappa is not None):
        what = "kappa is required with trigger integral" if rule.kappa is None else "kappa is of trigger integral"
        yield Problem(("observer", "rule"), what, hint="rule: {trigger: integral, kappa: 0.3}")
    if family.read == "one" and plant.p == 1:
        what = "one of several outputs is chosen; this plant has one"
        yield Problem(("observer", "read"), what, "one", hint="leave it out")
    T_min = None if law is None else law.T_min
    if family.budget is not None and T_min is not None:
        yield Problem(("observer", "budget"), "says T_min already: 1 / budget", hint="leave law.T_min out")
    fixed = family.budget is not None or T_min is not None
    if family.objective == "min_error" and not fixed:
        hint = "budget: 5, the most measurements per time; or law: {T_min: 0.2}"
        yield Problem(("observer", "objective"), "least error needs a budget of measurements", hint=hint)
    if family.objective == "min_error" and not plant.is_perturbed:
        hint = "declare measurement.noise or plant.disturbance"
        yield Problem(("observer", "objective"), "least error needs noise or a disturbance", hint=hint)
    yield from _of_errors(family, plant, fixed)


def _of_errors(family: UpdatedSampling, plant: Plant, fixed: bool) -> Iterator[Problem]:
    if family.error_at_most is None:
        return
    at = ("observer", "error_at_most")
    for state in family.error_at_most:
        if state not in plant.states:
            yield Problem((*at, state), "is no state", state, ", ".join(plant.states))
    if not plant.is_perturbed or plant.covariance is not None:
        what, hint = "an error under noise needs noise or a disturbance with bounds", "declare measurement.noise"
        yield Problem(at, what, hint=hint)
    if fixed:
        what, hint = "the longest time between samples that keeps an error is looked for", "leave budget, T_min out"
        yield Problem(at, what, hint=hint)


def _of_law(family: UpdatedSampling, plant: Plant) -> Iterator[Problem]:
    law, n, p = family.law, plant.n, plant.p
    if law is None:
        return
    at = ("observer", "law")
    shapes = dict(zip(MATRICES, ((n, n), (n, n), (1, p), (1, n)), strict=True))
    for name, shape in shapes.items():
        typed: ExactMatrix | None = getattr(law, name)
        if typed is not None and typed.shape != shape:
            got, allowed = (f"{rows} x {columns}" for rows, columns in (typed.shape, shape))
            yield Problem((*at, name), "has another shape", got=got, allowed=allowed)
    if law.split is not None and law.split.shape == (n, n):
        for i, j in plant.slopes.entries:
            if law.split[i, j].sign() != 1:
                what = "is positive where a slope is"
                yield Problem((*at, "split", i, j), what, got=str(law.split[i, j]), allowed="a positive number")
    if law.Lambda is not None and any(one.sign() != 1 for one in law.Lambda.rows[0]):
        yield Problem((*at, "Lambda"), "weights are positive", got=str(law.Lambda.texts()))
    if law.gamma is not None and any(one.sign() not in (0, 1) for one in law.gamma.rows[0]):
        yield Problem((*at, "gamma"), "weights are not negative", got=str(law.gamma.texts()))
    for name, most in (("theta", "below 1"), ("idle", "at most 1")):
        value = getattr(law, name)
        if value is not None and (float(value) > 1 or (name == "theta" and float(value) == 1)):
            yield Problem((*at, name), f"is {most}", got=str(value))
    for name in shapes:
        typed = getattr(law, name)
        if typed is not None and any(one.rational is None for row in typed.rows for one in row):
            yield Problem((*at, name), "decimals and fractions are expected", got=str(typed.texts()))
    for name in NUMBERS:
        number = getattr(law, name)
        if number is not None and number.rational is None:
            yield Problem((*at, name), "a decimal or a fraction is expected", got=str(number))
    if (
        law.F is not None
        and law.F.shape == (n, n)
        and any(law.F[i, j] != law.F[j, i] for i in range(n) for j in range(i))
    ):
        yield Problem((*at, "F"), "is symmetric", got=str(law.F.texts()))
    if law.F is not None and not is_whole(family):
        hint = "type split, sigma and T_min (or budget) as well, or leave F out to have it found"
        yield Problem((*at, "F"), "a floor belongs to a whole law", hint=hint)
    if law.share is not None and (law.F is not None or float(law.share) > 1):
        what, hint = "is of an F that is found, at most 1 of the largest", "leave law.F out, or law.share"
        yield Problem((*at, "share"), what, got=str(law.share), hint=hint)
    if law.gamma is not None and law.F is None:
        yield Problem((*at, "gamma"), "belongs to a whole law", hint="leave it out to have it found")
