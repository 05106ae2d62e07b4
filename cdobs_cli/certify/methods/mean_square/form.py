"""What mean square bounds ask besides the inequalities of an error bound (`peak.form`), and integrals of what is in
Bernstein form."""

from __future__ import annotations

from typing import Any

from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.exact.matrix import block


def paid(slope: Any, lyapunov: Any, Z: Any) -> Any:
    """-(Pdot + P A + A'P + Z) >= 0: while e'Pe falls it pays for e'Ze."""
    return -(slope + lyapunov + Z)


def spread_block(X: Any, W: Any, P_0: Any) -> Any:
    """[[X, W'], [W, P(0)]] >= 0: X >= K'P(0)K with W = P(0) K."""
    return block([[X, W.T], [W, P_0]])


def instants(shape: Shape, lengths: list[Any]) -> list[Any]:
    """The Bernstein coefficients of tau itself, of degree d + 1 on each piece, ends shared: so many as `sums`."""
    times, start = [lengths[0] * 0], lengths[0] * 0
    for h in lengths:
        times += [start + h * (k + 1) / (shape.d + 1) for k in range(shape.d + 1)]
        start = times[-1]
    return times


def sums(q: list[Any], shape: Shape, lengths: list[Any]) -> list[Any]:
    """The Bernstein coefficients of int_0^tau q, of degree d + 1 on each piece, ends shared; q of degree d, its
    coefficients numbered through as those of P."""
    total = q[0] * 0
    values = [total]
    for j, h in enumerate(lengths):
        for k in range(shape.d + 1):
            total = total + q[j * shape.d + k] * h / (shape.d + 1)
            values.append(total)
    return values


def sample_instants(shape: Shape) -> range:
    """Which of the coefficients of `instants` and `sums` cover [T_min, T_max]: the last alone where all periods are
    one."""
    return range(shape.before * (shape.d + 1), shape.pieces * (shape.d + 1) + 1)
