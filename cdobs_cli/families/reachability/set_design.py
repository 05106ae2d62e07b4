"""Gains and certificates by the set: for one period, and for the largest."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.bracket import largest_proved
from cdobs_cli.exact.numbers import Exact, ExactMatrix, plain_decimal
from cdobs_cli.families.reachability.kernel import Kernel, kernel
from cdobs_cli.families.reachability.proof import METHOD, SetProof, prove
from cdobs_cli.families.reachability.search import Log, Members, contraction, design, fastest, lyapunov, members
from cdobs_cli.families.reachability.sets import matrix_set, set_limit
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from cdobs_cli.families.reachability import Reachability

    Array = NDArray[np.float64]

DIGITS = (5, 7, 9, 12)
Q_DIGITS = 13


@dataclass(frozen=True)
class Found:
    """A printed gain with a certificate that is proved."""

    K: ExactMatrix
    certificate: Certificate
    proof: SetProof


class SetSearch:
    """The search for one family block and plant; it keeps count of the solver's work."""

    def __init__(self, family: Reachability, plant: Plant, effort: int) -> None:
        self.family, self.plant, self.effort = family, plant, effort
        self.kernel: Kernel = kernel(plant.C)
        self.log = Log()

    def data(self, delta: Exact) -> Members | None:
        """The members that matter at delta, as floats; None where the set could not be enclosed."""
        boxes = matrix_set(self.family, self.plant, delta)
        if boxes is None:
            return None
        data = members(boxes, self.kernel)
        return data if np.all(np.isfinite(data.M)) and np.all(np.isfinite(data.A)) and np.all(np.isfinite(data.b)) else None

    def gain_at(self, delta: Exact, *, fast: bool = False) -> Found | None:
        """A gain for delta: the one of the largest margin, or about the one of the fastest proved decay."""
        if self.kernel.dimension == 0:
            return self._dead_beat(delta)
        data = self.data(delta)
        if data is None:
            return None
        guess = design(data, self.log)
        if guess.margin <= 0:
            return None
        if fast:
            guess = self._fastest_gain(data, guess)
        Z = data.Z(guess.Z)
        for digits in DIGITS:
            K = self.kernel.gain(ExactMatrix.from_floats(Z, digits), digits + 2)
            found = self.certificate_at(delta, K, rounds=3 if fast else 0, Q=guess.Q if self.kernel.is_kept(K) else None, data=data)
            if found is not None:
                return found
        return None

    def certificate_at(
        self, delta: Exact, K: ExactMatrix, *, rounds: int = 4, Q: Array | None = None, data: Members | None = None
    ) -> Found | None:
        """A proved certificate for a given K, or None. `Q` (scaled) is tried instead of a search."""
        if self.kernel.dimension == 0 and self.kernel.is_kept(K):
            return self._dead_beat(delta)
        data = data or self.data(delta)
        if data is None:
            return None
        if not self.kernel.is_kept(K):
            return self._full_certificate(delta, K)
        F = error_maps(data, self.kernel, K)
        if Q is None or rounds:
            rho, best = fastest(F, self.log, rounds)
            Q = best if Q is None or rho < contraction(Q, F) else Q
        if contraction(Q, F) >= 1:
            return None
        printed = ExactMatrix.from_floats(symmetric(data.Q(Q)), Q_DIGITS)
        rho_squared = _above(contraction(_unscale(data, printed.floats), F) ** 2)
        document = {"form": "reduced", "Q": printed.texts(), "rho_squared": rho_squared}
        s = self._shift(delta, K, printed.floats)
        if s is not None:
            document["s"] = s
        return self._proved(K, Certificate(METHOD, SamplingLaw.periodic(delta), document))

    def margin_of(self, K: ExactMatrix, delta: Exact) -> float:
        """The margin of the best Lyapunov matrix for a given K, in floats; -1 where the set is not known."""
        if self.kernel.is_kept(K):
            data = self.data(delta)
            return lyapunov(error_maps(data, self.kernel, K), self.log)[0] if data else -1.0
        N_M = self._full_maps(K, delta)
        return lyapunov(N_M[1], self.log)[0] if N_M else -1.0

    def largest_any(self, start: Exact) -> Found | None:
        """A gain for the largest period found, at least `start`."""
        if self.kernel.dimension == 0:
            return self._dead_beat(start)
        end = largest(self._any_margin, start, set_high(self.plant))
        return None if end is None else self._last_proved(self.gain_at, start, end)

    def longest_any(self, start: Exact) -> float | None:
        """Up to which period the set gives a gain, in floats; looks below `start` too."""
        for _ in range(12):
            end = largest(self._any_margin, start, set_high(self.plant))
            if end is not None:
                return float(end)
            start = rounded_down(Fraction(float(start)) / 2, 6)
        return None

    def _any_margin(self, delta: Exact) -> float:
        data = self.data(delta)
        return design(data, self.log).margin if data else -1.0

    def largest_for(self, K: ExactMatrix, start: Exact) -> Found | None:
        """The certificate of a given K for the largest period found; below `start` where it fails there."""
        if self.kernel.dimension == 0 and self.kernel.is_kept(K):
            return None
        low, high = start, set_high(self.plant)
        for _ in range(12):
            if float(low) <= high and self.margin_of(K, low) > 0:
                break
            low = rounded_down(Fraction(float(low)) / 2, 6)
        else:
            return None
        end = largest(lambda delta: self.margin_of(K, delta), low, high)
        return None if end is None else self._last_proved(lambda delta: self.certificate_at(delta, K, rounds=0), low, end)

    def _last_proved(self, prove: Callable[[Exact], Found | None], start: Exact, end: Fraction) -> Found | None:
        """The proof at the largest short period up to `end` that has one: the proofs decide, not the margins."""
        high = rounded_down(end, 6)
        if not float(high) > float(start):
            return prove(start)
        found = largest_proved(prove, start, high, Fraction(1, 2000))
        return None if found is None else found[1]

    def _full_maps(self, K: ExactMatrix, delta: Exact) -> tuple[Members, Array] | None:
        """(I - K C) M at every member of the whole space, scaled."""
        boxes = matrix_set(self.family, self.plant, delta)
        if boxes is None:
            return None
        data = members(boxes, Kernel(*_no_measurement(self.plant.n)))
        J = np.eye(self.plant.n) - K.floats @ self.plant.C.floats
        N_M = (data.s[:, None] * J / data.s) @ data.M
        return (data, N_M) if np.all(np.isfinite(N_M)) else None

    def _full_certificate(self, delta: Exact, K: ExactMatrix) -> Found | None:
        maps = self._full_maps(K, delta)
        if maps is None:
            return None
        data, N_M = maps
        rho, P = fastest(N_M, self.log, 3)
        if rho >= 1:
            return None
        printed = ExactMatrix.from_floats(symmetric(data.Q(P)), Q_DIGITS)
        rho_squared = _above(contraction(_unscale(data, printed.floats), N_M) ** 2)
        document = {"form": "full", "P": printed.texts(), "rho_squared": rho_squared}
        return self._proved(K, Certificate(METHOD, SamplingLaw.periodic(delta), document))

    def _proved(self, K: ExactMatrix, certificate: Certificate) -> Found | None:
        proof = prove(self.family, self.plant, K, certificate)
        return Found(K, certificate, proof) if proof.holds else None

    def _dead_beat(self, delta: Exact) -> Found | None:
        K = self.kernel.gain(None, 12)
        document = {"form": "reduced", "Q": [], "rho_squared": "0"}
        return self._proved(K, Certificate(METHOD, SamplingLaw.periodic(delta), document))

    def _fastest_gain(self, data: Members, guess: Any) -> Any:
        """Bisection on rho: the inequality for the members divided by rho."""
        from dataclasses import replace

        F = data.A - guess.Z @ data.b
        high, low, best = contraction(guess.Q, F), 0.0, guess
        for _ in range(8 + 2 * self.effort):
            middle = max((low + high) / 2, 0.7 * high)
            trial = design(replace(data, M=data.M / middle), self.log)
            if trial.margin > 0:
                high, best = min(high, contraction(trial.Q, data.A - trial.Z @ data.b)), trial
            else:
                low = middle
            if high - low < 2e-3 * high:
                break
        return best

    def _shift(self, delta: Exact, K: ExactMatrix, Q: Array) -> str | None:
        """s of `recovered_P` for which the paper's kappa is about largest; None where none was found."""
        from cdobs_cli.families.reachability.proof import MAX_STATES_OF_CONSTANTS

        boxes = matrix_set(self.family, self.plant, delta)
        if boxes is None or self.plant.n > MAX_STATES_OF_CONSTANTS:
            return None
        everything = list(range(self.plant.n))
        M = np.concatenate([box.members(list(box.signs(everything))) for box in boxes])
        C, R = self.kernel.C_r.floats, self.kernel.R.floats
        J = np.eye(self.plant.n) - K.floats @ self.plant.C.floats
        base, image = (R @ J).T @ Q @ (R @ J), R @ J @ M
        drop = base - np.swapaxes(image, 1, 2) @ Q @ image
        unit = float(np.trace(Q)) / (float(np.trace(C.T @ C)) or 1.0)
        best: tuple[float, float] = (0.0, 0.0)
        for power in np.arange(-3.0, 9.0, 0.5):
            s = unit * 10.0**power
            top = float(np.linalg.eigvalsh(base + s * C.T @ C)[-1])
            kappa = float(np.min(np.linalg.eigvalsh(drop + s * C.T @ C)[:, 0])) / top
            best = max(best, (kappa, s))
        return _decimal(Fraction(best[1]), 4, ROUND_CEILING) if best[0] > 0 else None


def error_maps(data: Members, kernel: Kernel, K: ExactMatrix) -> Array:
    """F = R (I - K C) M N at every member, scaled; shape (V, r, r)."""
    K_r = K.floats[:, list(kernel.rows)]
    Z = (data.s[:, None] * K_r) / data.s_output
    F: Array = data.A - (data.R @ Z) @ data.b
    return F


def largest(margin: Callable[[Exact], float], low: Exact, high: float) -> Fraction | None:
    """Where the margin crosses zero above `low`: false position between a period that holds and
    one that does not, then halving, to seven digits. Returns the largest period tried with a positive margin."""
    start = float(low)
    a, f_a = start, margin(low)
    if not f_a > 0:
        return None
    b = min(2 * start, high)
    f_b = margin(Exact(Fraction(b)))
    while f_b > 0:
        if b >= high or b > 1e9 * start:
            return Fraction(b)
        a, f_a, b = b, f_b, min(2 * b, high)
        f_b = margin(Exact(Fraction(b)))
    if not np.isfinite(f_b):
        f_b = -1.0
    side = 0
    for count in range(40):
        if b - a <= 1e-7 * b:
            break
        share = min(max(f_a / (f_a - f_b), 0.02), 0.98) if f_b < 0 and count < 12 else 0.5
        middle = a + share * (b - a)
        value = margin(Exact(Fraction(middle)))
        value = value if np.isfinite(value) else -1.0
        if value > 0:
            a, f_a = middle, value
            f_b, side = (f_b / 2 if side == 1 else f_b), 1
        else:
            b, f_b = middle, value
            f_a, side = (f_a / 2 if side == -1 else f_a), -1
    return Fraction(a)


def symmetric(matrix: Array) -> Array:
    """Its symmetric part."""
    value: Array = (matrix + matrix.T) / 2
    return value


def _unscale(data: Members, Q: Array) -> Array:
    s = data.s[list(data.others)]
    value: Array = symmetric(Q / s[:, None] / s)
    return value


def _no_measurement(n: int) -> Any:
    from cdobs_cli.exact.matrix import Matrix

    identity = Matrix.identity(n)
    nothing = Matrix.zeros(0, n)
    return nothing, (), (), tuple(range(n)), identity, identity, Matrix.zeros(n, 0), nothing


def _above(value: float) -> str:
    """A decimal a little above a float's value: room for its rounding errors."""
    return _decimal(Fraction(value) * (1 + Fraction(1, 10**9)) + Fraction(1, 10**14), 12, ROUND_CEILING)


def _decimal(value: Fraction, digits: int, rounding: str) -> str:
    return plain_decimal(Context(prec=digits, rounding=rounding).divide(Decimal(value.numerator), Decimal(value.denominator)))


def rounded_down(value: Fraction, digits: int) -> Exact:
    """The largest decimal of so many digits that is not above the value."""
    return Exact(_decimal(value, digits, ROUND_FLOOR))


def set_high(plant: Plant) -> float:
    """Up to which delta the set can be used, as a float a little below the proved limit."""
    limit = set_limit(plant)
    return float(limit.lower()) if limit.is_finite() else float("inf")
