"""The search for a law: constants with the least proved error at a given T_min, or the longest T_min, in floats.

At the largest slopes Pi -> Pi(T_min) + C'Lambda C has a largest fixed point, where it has one: the invariant subspace
of its Hamiltonian matrix to the eigenvalues outside the unit circle. F is a little below it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from fractions import Fraction
from functools import cached_property, partial
from math import inf

import numpy as np
from scipy.linalg import LinAlgError, expm

from cdobs_cli.arrays import Array
from cdobs_cli.certify.simplex import smallest
from cdobs_cli.exact.numbers import Exact, ExactMatrix, decimal_text
from cdobs_cli.families.updated_sampling.carried.law import Law, hamiltonian, strengths
from cdobs_cli.plant import Entry, Plant
from cdobs_cli.records import dataclass

EVALUATIONS = (60, 150, 300, 600)  # of one search, by effort
SLACK = 1.02  # by which sigma is larger, and Lambda smaller, where F is found: what is given away
_STEPS = 16  # of [0, T_min] at which Pi is looked at
_DIGITS = 10
_CLEAR = 10.0 ** (2 - _DIGITS)  # of F_ii F_jj: nearer to singular, F would not be definite once it is rounded
_ROOM = 100.0  # times epsilon
_MOST = 1e6  # times what the outputs tell of a state, that Pi may come to
_LOWEST = 0.05  # of F, down to which Pi may dip on the way to T_min
_STEP = 0.4  # of the first simplex, in logarithms
SHARES = (0.999, 0.99, 0.97, 0.93, 0.85, 0.7)
LOWER = (0.5, 0.35, 0.2)  # shares of the mean of several choices


@dataclass(frozen=True)
class Target:
    """What a law is for, in floats. A (n, n), C (p, n); cbar_ij; v, d: the largest noise of each output (1 where none
    is declared) and disturbance of each state; weights: Lambda, V in units of the noise unless it is typed; split and
    sigma where they are typed; share: of the largest F that there is; one: whether a sample reads one
    output alone."""

    A: Array
    C: Array
    largest: Mapping[Entry, float]
    v: Array
    d: Array
    idle: float
    weights: Array
    split: Mapping[Entry, float]
    sigma: float | None
    epsilon: float
    share: float
    one: bool = False

    @property
    def gains(self) -> list[Array]:
        """C'Lambda C of each choice of outputs."""
        rows = [[k] for k in range(len(self.C))] if self.one else [list(range(len(self.C)))]
        return [self.C[row].T @ np.diag(self.weights[row]) @ self.C[row] for row in rows]

    @staticmethod
    def of(
        plant: Plant,
        largest: Mapping[Entry, Fraction],
        idle: Exact,
        epsilon: Exact,
        Lambda: ExactMatrix | None = None,
        split: ExactMatrix | None = None,
        sigma: Exact | None = None,
        share: Exact | None = None,
        one: bool = False,
    ) -> Target:
        d = np.array([0.0] * plant.n if plant.disturbance is None else plant.disturbance.float_sizes)
        v = _noise(plant)
        typed = {} if split is None else {entry: float(split[entry]) for entry in largest}
        floats = {entry: float(bound) for entry, bound in largest.items()}
        own = 1 / v**2 if Lambda is None else Lambda.floats[0]
        return Target(
            plant.A.floats, plant.C.floats, floats, v, d, float(idle), own, typed,
            None if sigma is None else float(sigma), float(epsilon), 1.0 if share is None else float(share), one,
        )  # fmt: skip

    @cached_property
    def limit(self) -> Array:
        """gamma of each state that keeps Pi finite: where A decays by itself Pi would grow until floats cannot hold it.

        It is as if there were a disturbance too small to matter; 0 where nothing decays.
        """
        n, fastest = len(self.A), max(0.0, float(np.max(-np.linalg.eigvals(self.A).real)))
        if fastest == 0.0:
            return np.zeros(n)
        told, power = np.zeros(n), np.eye(n)
        for _ in range(n):
            told += self.weights @ (self.C @ power) ** 2
            power = power @ self.A / fastest
        with np.errstate(divide="ignore"):
            return np.where(told > 0, 2 * fastest / (_MOST * told), 0.0)

    @property
    def times(self) -> tuple[float, float]:
        """Where T_min is looked for: around the shortest time scale of flow and slopes."""
        steepest = np.abs(self.A).copy()
        for entry, bound in self.largest.items():
            steepest[entry] += bound
        rate = float(np.max(np.abs(np.linalg.eigvals(steepest)))) or 1.0
        return 1e-4 / rate, 32 / rate


def _noise(plant: Plant) -> Array:
    """The size of the noise of each output: its bound or deviation, 1 where none is declared, never 0."""
    if plant.covariance is not None:
        sizes = np.sqrt(np.maximum(np.diag(plant.covariance.floats), 0.0))
    else:
        sizes = np.array([1.0] * plant.p if plant.noise is None else plant.noise.float_sizes)
    least = float(sizes.max()) * 1e-3 or 1.0
    return np.maximum(sizes, least)


@dataclass(frozen=True)
class Candidate:
    """A law in floats: what `Law` holds, and the error that it leaves of each state where F is its floor."""

    F: Array
    split: Array
    gamma: Array
    sigma: float
    T: float
    errors: Array


def start(target: Target, T: float) -> Array:
    """Logarithms where a search begins: l that balances both halves of 2 a b <= l a^2 + b^2 / l for Pi of a chain."""
    weight = float(target.weights.max())
    split = [-(i + j) * np.log(T) - np.log(weight) for i, j in target.largest]
    return np.array([*split, np.log(0.15 / T), *([np.log(T)] if target.d.any() else [])])


def _parts(target: Target, logs: Array) -> tuple[Array, float, Array]:
    """l (n, n), sigma, gamma (n,)."""
    n, values = len(target.A), np.exp(np.clip(logs, -60, 60))
    split = np.zeros((n, n))
    for (i, j), value in zip(target.largest, values, strict=False):
        split[i, j] = value
    # So that a disturbance adds to V, in T_min, about what the noise of one sample does.
    gamma = values[-1] * target.d**2 if target.d.any() else np.zeros(n)
    gamma = np.maximum(gamma, target.limit)
    return split, float(values[len(target.largest)]), gamma


def _matrix(target: Target, split: Array, sigma: float, gamma: Array) -> Array:
    cl = {entry: bound * split[entry] for entry, bound in target.largest.items()}
    c_over_l = {entry: bound / split[entry] for entry, bound in target.largest.items()}
    B, Q = strengths(len(target.A), cl, c_over_l, list(gamma), 0.0)
    return np.array(hamiltonian(target.A.tolist(), B, Q, sigma, 0.0))


def fixed_point(H: Array, CWC: Array, T: float) -> Array | None:
    """The largest Pi = Pi(T) + C'Lambda C, just after a sample; None where there is none."""
    n = len(CWC)
    try:
        E = expm(H * T)
        E[n:] = E[n:] + CWC @ E[:n]
        values, vectors = np.linalg.eig(E)
        if not np.all(np.isfinite(values)) or np.sum(np.abs(values) > 1 + 1e-9) != n:
            return None
        outside = vectors[:, np.abs(values) > 1]
        Pi = np.real(outside[n:] @ np.linalg.inv(outside[:n]))
    except (LinAlgError, ValueError):
        return None
    symmetric: Array = (Pi + Pi.T) / 2
    return symmetric


def _path(H: Array, first: Array, T: float) -> list[Array] | None:
    """Pi at `_STEPS` + 1 times of [0, T]; None where it loses its sign."""
    n = len(first)
    step, Z = expm(H * T / _STEPS), np.vstack([np.eye(n), first])
    kept = [first]
    for _ in range(_STEPS):
        Z = step @ Z
        form = Z[:n].T @ Z[n:]
        if not np.all(np.isfinite(form)) or np.linalg.eigvalsh((form + form.T) / 2)[0] <= 0:
            return None
        Pi = Z[n:] @ np.linalg.inv(Z[:n])
        Z = np.vstack([np.eye(n), (Pi + Pi.T) / 2])
        kept.append(Z[n:])
    return kept


def candidate(target: Target, T: float, logs: Array) -> Candidate | None:
    """The law of these constants, with F a little below the fixed point; None where there is none, or floats cannot
    tell, so near is F to singular."""
    try:
        return _below_fixed_point(target, T, logs)
    except LinAlgError:
        return None


def _below_fixed_point(target: Target, T: float, logs: Array) -> Candidate | None:
    """Raises: LinAlgError where a matrix is not definite, or singular, in floats."""
    split, sigma, gamma = _parts(target, logs)
    top = _top(target, _matrix(target, split, sigma * SLACK, gamma), T)
    if top is None:
        return None
    H = _matrix(target, split, sigma, gamma)
    for share in (*SHARES, *(LOWER if target.one else ())):
        F = target.share * share * top
        paths = [_path(H, F + CWC, T) for CWC in target.gains]
        if all(path is not None and _is_above(path, F, target.epsilon) for path in paths):
            errors = [_errors(target, [*path, F], sigma, T, gamma) for path in paths if path is not None]
            return Candidate(F, split, gamma, sigma, T, np.max(errors, axis=0))
    return None


def _top(target: Target, H: Array, T: float) -> Array | None:
    """About the largest F: below the fixed point; of several choices of outputs the harmonic mean, which is near each
    of them in its own weak directions. None where there is none. Raises: LinAlgError, as its caller."""
    tops = []
    for CWC in target.gains:
        periodic = fixed_point(H, CWC / SLACK, T)
        if periodic is None or not _is_clear(periodic - CWC / SLACK):
            return None
        tops.append(periodic - CWC / SLACK)
    if len(tops) == 1:
        return tops[0]
    mean: Array = np.linalg.inv(np.mean([np.linalg.inv(one) for one in tops], axis=0)).astype(np.float64)
    return mean


def _is_clear(M: Array) -> bool:
    """Whether M stays definite when it is rounded."""
    sizes = np.sqrt(np.maximum(np.diag(M), 0.0))
    return bool(sizes.min() > 0 and np.linalg.eigvalsh(M / np.outer(sizes, sizes))[0] >= _CLEAR)


def _is_above(path: list[Array], F: Array, epsilon: float) -> bool:
    """Whether Pi stays in sight of F, and det(Pi - F) / det F at T_min is well above where a sample is due."""
    root = np.linalg.inv(np.linalg.cholesky(F))
    levels = [float(np.linalg.eigvalsh(root @ Pi @ root.T)[0]) for Pi in path]
    above = np.linalg.eigvalsh(root @ path[-1] @ root.T) - 1
    return bool(above[0] > 0 and np.prod(above) > _ROOM * epsilon and min(levels) > _LOWEST)


def _errors(target: Target, path: list[Array], sigma: float, T: float, gamma: Array) -> Array:
    """What is left of each state's error: `errors` in floats, at the times of the path and at T with F, its last."""
    slowest = 2 * sigma * target.idle
    sample = target.weights * target.v**2
    noise = float(sample.max() if target.one else sample.sum()) / -np.expm1(-slowest * T)
    steady = sum((d**2 / g for d, g in zip(target.d, gamma, strict=True) if d > 0), 0.0) / slowest
    times = [*np.linspace(0, T, len(path) - 1), T]
    squares = [
        (noise * np.exp(-slowest * t) + steady) * np.diag(np.linalg.inv(Pi)) for t, Pi in zip(times, path, strict=True)
    ]
    errors: Array = np.sqrt(np.max(squares, axis=0))
    return errors


def has_law(target: Target, T: float) -> bool:
    """Whether there is any law at T_min = T, where it is looked for."""
    return _somewhere(target, T) is not None


def _score(target: Target, T: float, logs: Array) -> float:
    """The size of the errors that these constants leave; infinite where they are no law."""
    with np.errstate(all="ignore"):  # far from any law numbers overflow; those are no candidates
        made = candidate(target, T, _pinned(target, logs))
    return inf if made is None else float(np.linalg.norm(made.errors))


def least_error(target: Target, T: float, effort: int) -> Candidate | None:
    """The law with the least sum of squared errors at T_min = T."""
    first = _somewhere(target, T)
    if first is None or (target.split and target.sigma is not None and not target.d.any()):
        return None if first is None else candidate(target, T, _pinned(target, first))
    evaluations = EVALUATIONS[min(effort, 3)] * max(1, len(first) // 2)
    logs, _ = smallest(partial(_score, target, T), first, np.full(len(first), _STEP), evaluations)
    return candidate(target, T, _pinned(target, logs))


def _pinned(target: Target, logs: Array) -> Array:
    """With what is typed in place of what is looked for."""
    logs = logs.copy()
    logs[: len(target.split)] = np.log(list(target.split.values()))
    if target.sigma is not None:
        logs[len(target.largest)] = np.log(target.sigma)
    return logs


def _somewhere(target: Target, T: float) -> Array | None:
    """A point where there is a law at all: around the middle, then slower and with less of a disturbance in it."""
    middle, slopes = start(target, T), len(target.largest)
    for slower in (0.0, -1.5, -3.0, -5.0, -8.0):
        best, least = None, inf
        for shift in (0.0, 1.5, -1.5, 3.0, -3.0):
            logs = middle.copy()
            logs[:slopes] += shift
            logs[slopes:] += slower
            value = _score(target, T, logs)
            if value < least:
                best, least = logs, value
        if best is not None:
            return best
    return None


def longest(exists: Callable[[float], bool], least: float, most: float, rounds: int = 24) -> float | None:
    """The longest T with a law, by bisection of its logarithm; None where there is none from `least` on."""
    if exists(most):
        return most
    T = most
    while not exists(T):
        T /= 2
        if least > T:
            return None
    low, high = T, 2 * T
    for _ in range(rounds):
        middle = float(np.sqrt(low * high))
        low, high = (middle, high) if exists(middle) else (low, middle)
        if high / low < 1.005:
            break
    return low


def rounded(found: Candidate, target: Target, share: float) -> Law:
    """A law in decimals with a share of F; what a spec has its say in is left to the caller."""
    weights = [float(weight) for weight in target.weights]
    later = Exact(1)
    return Law(
        ExactMatrix.from_floats(share * (found.F + found.F.T) / 2, _DIGITS), ExactMatrix.from_floats(found.split, 6),
        ExactMatrix.from_floats([weights], 6), ExactMatrix.from_floats([list(found.gamma)], 6),
        sigma=Exact(decimal_text(found.sigma, 6)), theta=later, idle=later, T_min=later, epsilon=later,
        kappa=None, reset=False, one=False,
    )  # fmt: skip
