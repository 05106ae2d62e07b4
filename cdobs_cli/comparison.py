"""The observer beside the extended Kalman filter: in one loop, on the same measurements of the same plant.

The filter knows what is declared: the covariance R of the noise and the intensity Q of the disturbance; of a box the
middle, and the moments of what is uniform in it. For v within v_0 of the middle, R = v_0^2/3. A disturbance within d_0
that is held over T_k adds (d_0 T_k)^2/3 to the variance of its integral: by unit of time,

    Q = d_0^2/3 sum T_k^2/sum T_k,   d_0^2/3 T for a constant period.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from cdobs_cli.arrays import Array
from cdobs_cli.baselines.kalman import MAX_OUTPUTS, extended_kalman_filter
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix, decimal_text
from cdobs_cli.hybrid import HybridSystem, Observer
from cdobs_cli.plant import Box, Plant
from cdobs_cli.run import Compared, Comparison, Filtered, Run, SimulationPlan, Trajectory
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.simulate.record import Paths
from cdobs_cli.simulate.summary import quadratic_means, root_mean_squares

SEEDS = 8
MAX_STATES = 8
# What a run takes, in microseconds: to be set up, for a sample, for a step, and more for a step of a white disturbance;
# each, but the last, also by the nodes of the expressions that it works with.
_SET_UP, _SAMPLE, _STEP, _WHITE = (20_000, 20.0), (250, 0.4), (30, 0.3), 110
BUDGET = 1_200_000
_KNOWN = 0.01  # of the largest size of a state: the least deviation that its start is given
_THIRD = Exact(Fraction(1, 3))
_HALF = Exact(Fraction(1, 2))


class NoFilterError(ValueError):
    """Why there is nothing to compare with, in a sentence."""


def compared(run: Run, system: HybridSystem, plan: SimulationPlan, law: SamplingLaw) -> Run:
    """A run with the comparison beside it; as it is where nothing is declared or the observer has no x_hat."""
    plant = system.plant
    if not plant.is_perturbed or "x_hat" not in system.observer.estimates:
        return run
    try:
        runs = _together(run, system, plan, law)
    except NoFilterError as error:
        alone = {name: Compared(value, None) for name, value in run.overall.rmse_after_transient.items()}
        return replace(run, comparison=Comparison(len(run.summaries), alone, str(error)))
    own, theirs = (
        quadratic_means([_figures(plant, one, name, late=True) for one in runs]) for name in ("x_hat", "ekf")
    )
    states = {name: Compared(own[name], theirs[name]) for name in own if name in theirs}
    filtered = Filtered(runs[0].t, _error(runs[0], "ekf").T)
    return replace(run, comparison=Comparison(len(runs), states), filtered=filtered)


def errors_beside(
    system: HybridSystem, other: Observer, plan: SimulationPlan, law: SamplingLaw, runs: int, *, late: bool
) -> dict[str, float]:
    """Root mean square errors of another observer on the measurements that the observer of the loop gets, by state,
    over runs 0 to runs - 1; `late`: after the transient.

    Raises: NoFilterError, where a run cannot be had or comes to no end.
    """
    joint, found = beside(system, other), []
    for number in range(runs):
        try:
            one = simulate(joint, replace(plan, runs=1), law, first=number)
        except SpecError as error:
            raise NoFilterError(f"Run {number + 1} cannot be had: {error.problems[0].what}.") from error
        if one.overall.stopped is not None:
            raise NoFilterError(f"Run {number + 1} does not come to its end: {one.overall.stopped}.")
        found.append(_figures(system.plant, one.trajectories[0], "ekf", late=late))
    return quadratic_means(found)


def _figures(plant: Plant, one: Trajectory, name: str, *, late: bool) -> dict[str, float]:
    """Root mean squares of the error of an estimate, by state; `late`: after the transient."""
    error = _error(one, name)
    return root_mean_squares(plant.states, Paths.one(one.t, error), error, late=late)[0]


def _error(one: Trajectory, name: str) -> Array:
    """Of an estimate, shape (n, N)."""
    error: Array = (one.estimates[name] - one.x).T
    return error


def _together(run: Run, system: HybridSystem, plan: SimulationPlan, law: SamplingLaw) -> list[Trajectory]:
    """Plant, observer and filter in one loop, run by run: as many as fit the budget, which counts and does not time.

    Raises: NoFilterError.
    """
    if system.plant.delays:
        raise NoFilterError("No filter is run beside measurements that arrive late.")
    if run.overall.stopped is not None:
        raise NoFilterError("The filter is not run beside a run that ends early.")
    joint = beside(system, filter_of(system.plant, run, plan))
    cost = _cost(joint, run)
    if cost > 2 * BUDGET:
        raise NoFilterError("The filter is not run beside: a run takes too many samples or steps.")
    runs: list[Trajectory] = []
    alone, most = replace(plan, runs=1), 4 * run.steps + 1000
    for number in range(max(1, min(SEEDS, BUDGET // cost))):
        try:
            one = simulate(joint, alone, law, first=number, max_steps=most)
        except SpecError as error:
            raise NoFilterError(f"Run {number + 1} cannot be had: {error.problems[0].what}.") from error
        if one.overall.stopped is not None:
            told = f"With the filter beside it run {number + 1} does not come to its end: {one.overall.stopped}."
            raise NoFilterError(told)
        runs.append(one.trajectories[0])
    return runs


def _cost(joint: HybridSystem, run: Run) -> int:
    """Of one run, in microseconds or so."""
    flow, jump = _nodes(joint.flow), max(map(_nodes, joint.observer.jumps or (joint.observer.jump,)))
    white = 0 if joint.plant.intensity is None else _WHITE
    step, sample = white + _STEP[0] + _STEP[1] * flow, _SAMPLE[0] + _SAMPLE[1] * jump
    set_up = _SET_UP[0] + _SET_UP[1] * (flow + jump)
    return int(set_up + sample * len(run.trajectories[0].t_k) + step * run.steps)


def _nodes(expressions: Sequence[Expression]) -> int:
    """Different nodes in all of them."""
    seen: set[Expression] = set()
    for expression in expressions:
        seen.update(expression.walk(seen))
    return len(seen)


def beside(system: HybridSystem, other: Observer) -> HybridSystem:
    """A second observer in the loop of the first, its estimate reported as `ekf`: it sets no input and no sample."""
    own = system.observer
    both = replace(
        own, states=(*own.states, *other.states), start=(*own.start, *other.start), flow=(*own.flow, *other.flow),
        jump=(*own.jump, *other.jump), jumps=tuple((*a, *b) for a, b in zip(own.jumps, other.jumps, strict=True)),
        estimates={**own.estimates, "ekf": other.estimates["x_hat"]},
    )  # fmt: skip
    return replace(system, observer=both)


def filter_of(plant: Plant, run: Run, plan: SimulationPlan) -> Observer:
    """The filter for what is declared. Raises: NoFilterError."""
    if plant.n > MAX_STATES or plant.p > MAX_OUTPUTS:
        raise NoFilterError(f"The filter is run beside for up to {MAX_STATES} states and {MAX_OUTPUTS} outputs.")
    if plant.sampling.is_on_change:
        raise NoFilterError("There is no filter beside: when sensors send hangs on this observer's estimate.")
    R = plant.covariance if plant.noise is None else _uniform(plant.noise)
    quiet = [k for k in range(plant.p) if R is None or R[k, k].sign() != 1]
    if R is None or quiet:
        which = "y" if plant.p == 1 else ", ".join(f"y{k + 1}" for k in quiet)
        raise NoFilterError(f"There is no filter: no noise is declared of {which}, so that R is singular.")
    middle_d, middle_v = _middle(plant.disturbance, plant.n), _middle(plant.noise, plant.p)
    phi = tuple(one + middle.expression for one, middle in zip(plant.phi, middle_d, strict=True))
    h = tuple(one + middle.expression for one, middle in zip(plant.outputs(), middle_v, strict=True))
    moved = any(middle.sign() != 0 for middle in middle_v)
    known = replace(plant, phi=phi, h=h if moved else plant.h)
    reads = [sorted(one.outputs) for one in plant.sampling.readings]
    try:
        return extended_kalman_filter(known, _intensity(plant, run), R, _start(plant, run, plan), reads)
    except (ValueError, ArithmeticError) as error:  # a slope that is no expression, numbers beyond floats
        raise NoFilterError(f"There is no filter: {error}.") from error


def _intensity(plant: Plant, run: Run) -> ExactMatrix:
    """Q, shape (n, n): as declared, or of a disturbance that is held from sample to sample."""
    if plant.intensity is not None:
        return plant.intensity
    if plant.disturbance is None:
        return ExactMatrix([[0] * plant.n for _ in range(plant.n)])
    periods = np.diff(run.trajectories[0].t_k)
    length = float(periods @ periods / periods.sum()) if len(periods) else float(run.trajectories[0].t[-1])
    return ExactMatrix.diagonal([one * _exact(length) for one in _variances(plant.disturbance)])


def _start(plant: Plant, run: Run, plan: SimulationPlan) -> ExactMatrix:
    """P(0), diagonal: of the error in the box that x(0) is drawn from, or of the one error there is; no state is known
    better than to a hundredth of the size it reaches."""
    first = run.trajectories[0]
    error = _error(first, "x_hat")[:, 0]
    variances = error**2
    if plan.initial_box is not None and plan.initial_state is None:
        middle = np.array([float(one) for one in _middle(plan.initial_box, plant.n)])
        drawn = np.array([float(one) for one in _variances(plan.initial_box)])
        variances = drawn + (first.estimates["x_hat"][0] - middle) ** 2
    least = (_KNOWN * np.abs(first.x).max(axis=0)) ** 2
    return ExactMatrix.diagonal([_exact(float(value)) for value in np.maximum(variances, least)])


def _variances(box: Box) -> list[Exact]:
    """Of what is uniform in a box."""
    half = [(high - low) * _HALF for low, high in zip(box.lower, box.upper, strict=True)]
    return [one * one * _THIRD for one in half]


def _uniform(box: Box) -> ExactMatrix:
    return ExactMatrix.diagonal(_variances(box))


def _middle(box: Box | None, size: int) -> tuple[Exact, ...]:
    return (EXACT_ZERO,) * size if box is None else box.middle


def _exact(value: float) -> Exact:
    return Exact(decimal_text(value, 12))
