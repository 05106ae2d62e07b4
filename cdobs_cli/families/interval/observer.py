"""The interval observer (12), (13) and the hull predictor as equations, and the system of their errors.

Derived coefficients (S^-1, S A S^-1, ..) are written as decimals of 20 digits; the proofs read the typed
matrices.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable, call
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import ExactMatrix, arb_fraction, decimal_text, fmpq_fraction
from cdobs_cli.families.interval.errors import error_maps
from cdobs_cli.families.interval.held_loop import closed_maps
from cdobs_cli.families.interval.parts import absolute, metzler_split, negative_part, positive_part
from cdobs_cli.families.interval.system import System
from cdobs_cli.hybrid import HybridInclusion, Observer
from cdobs_cli.plant import Box, Plant

_DIGITS = 20
_HALF = Number(Fraction(1, 2))
Equations = Any  # a numpy array of expressions


def interval_observer(plant: Plant, design: Design, *, intersect: bool) -> Observer:
    """Two copies of the model in z = S x, one for each bound; what acts from a sample to the next is held.

        z_lower' = P z_lower - N z_upper + S B u + g_lower,    z_upper' = P z_upper - N z_lower + S B u + g_upper
        g_lower  = P1 z_lower(t_k) - N1 z_upper(t_k) + S L y_k + delta_lower   (g_upper likewise)
        x_lower  = (S^-1)^+ z_lower - (S^-1)^- z_upper                          (x_upper likewise)

    Source: Efimov2016, (12), (13)
    Deviates: the diagonal of S A S^-1 is not split; with `intersect`, measured rows of z are cut to what y_k
        and the bounds of the noise leave at a sample.
    """
    system, n = System(plant, design.gain, intersect), plant.n
    z = system.z
    (P, N), (P1, N1) = (map(numbers, metzler_split(Q)) for Q in (z.Q0, z.Q1))
    low, up, g_low, g_up = (variables(word, n) for word in ("z_lower", "z_upper", "g_lower", "g_upper"))
    y, known, still = variables("y", plant.p), _known_input(plant, z.S), _zeros(2 * n)
    delta_low, delta_up = _delta(plant, z.S, z.SL)
    at_low, at_up = low.copy(), up.copy()
    for i, G in system.cut_rows.items():
        low_v, up_v = enclosure(G, *_ends(plant.noise, plant.p))
        value = numbers(G) @ y
        at_low[i], at_up[i] = call("max", low[i], (value - up_v)[0]), call("min", up[i], (value - low_v)[0])
    x_lower, x_upper = enclosure(z.R, low, up)
    return Observer(
        states=tuple(each.name for each in (*low, *up, *g_low, *g_up)),
        start=(*np.concatenate(enclosure(z.S, *_box(plant))), *still),
        flow=(*(P @ low - N @ up + known + g_low), *(P @ up - N @ low + known + g_up), *still),
        jump=(
            *at_low, *at_up,
            *(P1 @ at_low - N1 @ at_up + numbers(z.SL) @ y + delta_low),
            *(P1 @ at_up - N1 @ at_low + numbers(z.SL) @ y + delta_up),
        ),
        estimates={"x_lower": tuple(x_lower), "x_upper": tuple(x_upper)},
        control=_control(plant, design, low, up),
    )  # fmt: skip


def hull_observer(plant: Plant, design: Design) -> Observer:
    """The hull predictor: centre c, radius rho at samples in z = S x, and the maps exp(A s), Gamma_A(s) L and
    integrals of moduli since the last sample.

        |x - c| <= |F(s) S^-1| rho + integral |exp(A r)| d_rad + |Gamma_A(s) L| v_rad,   F = exp(A s) - Gamma_A L C
    """
    n, p, z = plant.n, plant.p, System(plant, design.gain).z
    A, C, S, R, L = (numbers(M) for M in (plant.A.balls(), plant.C.balls(), z.S, z.R, design.gain["L"].balls()))
    c, g, rho, in_x, in_z = (variables(word, n) for word in ("c", "g", "rho", "in_x", "in_z"))
    E, H, y = variables("exp", n, n), variables("gain", n, p), variables("y", p)
    (d_mid, d_rad), (v_mid, v_rad) = _middle(*_ends(plant.disturbance, n)), _middle(*_ends(plant.noise, p))
    centre, radius = _middle(*_box(plant))
    FR = (E - H @ C) @ R
    spread = moduli(FR) @ rho + in_x + moduli(H) @ v_rad
    start, nothing = (*numbers(Matrix.identity(n)).flat, *_zeros(n * p)), _zeros(n)
    return Observer(
        states=tuple(each.name for each in (*c, *g, *rho, *in_x, *in_z, *E.flat, *H.flat)),
        start=(*centre, *nothing, *(numbers(absolute(z.S)) @ radius), *nothing, *nothing, *start),
        flow=(
            *(A @ c + _known_input(plant, Matrix.identity(n)) + g + d_mid), *nothing, *nothing,
            *(moduli(E) @ d_rad), *(moduli(S @ E) @ d_rad), *(A @ E).flat, *(A @ H + L).flat,
        ),
        jump=(
            *c, *(L @ (y - C @ c - v_mid)), *(moduli(S @ FR) @ rho + in_z + moduli(S @ H) @ v_rad),
            *nothing, *nothing, *start,
        ),
        estimates={"x_lower": tuple(c - spread), "x_upper": tuple(c + spread)},
        control=_control(plant, design, S @ c - rho, S @ c + rho),
    )  # fmt: skip


def enclosure(S: Matrix, lower: Equations, upper: Equations) -> tuple[Equations, Equations]:
    """S^+ lower - S^- upper and S^+ upper - S^- lower: the box of S x.

    Source: Efimov2016, (1)
    """
    plus, minus = numbers(positive_part(S)), numbers(negative_part(S))
    return plus @ lower - minus @ upper, plus @ upper - minus @ lower


def _delta(plant: Plant, S: Matrix, SL: Matrix) -> tuple[Equations, Equations]:
    """The box of delta = S d - S L v."""
    low_d, up_d = enclosure(S, *_ends(plant.disturbance, plant.n))
    low_v, up_v = enclosure(SL, *_ends(plant.noise, plant.p))
    return low_d - up_v, up_d - low_v


def _known_input(plant: Plant, S: Matrix) -> Equations:
    """S (B u + phi(u))."""
    total = _array(plant.phi)
    if plant.B is not None:
        for j, source in enumerate(plant.inputs):
            total = total + _array(plant.B[i, j].expression * Variable(source.name) for i in range(plant.n))
    return numbers(S) @ total


def _control(plant: Plant, design: Design, z_lower: Equations, z_upper: Equations) -> dict[str, Expression]:
    """u = K_lower z_lower + K_upper z_upper, where the design has feedback.

    Source: Efimov2016, (16)
    """
    if "K_lower" not in design.gain:
        return {}
    K_lower, K_upper = (numbers(design.gain[name].balls()) for name in ("K_lower", "K_upper"))
    return {source.name: u for source, u in zip(plant.inputs, K_lower @ z_lower + K_upper @ z_upper, strict=True)}


def inclusion(plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
    """The error system of both bounds with given S and L under the plant's sampling law; with feedback in the
    gain, together with the plant it closes."""
    if "K_lower" in gain and plant.B is not None:
        return HybridInclusion(closed_maps, plant, {**gain, "B": plant.B}, plant.sampling, ())
    return HybridInclusion(error_maps, plant, gain, plant.sampling, ())


def numbers(M: Matrix) -> Equations:
    """The entries as numbers: exact where they are short rationals, decimals of 20 digits otherwise."""
    return np.array([[_number(value) for value in row] for row in M.tolist()], dtype=object)


def _number(value: Any) -> Expression:
    if not isinstance(value, arb):
        exact = fmpq_fraction(value)
        return Number(exact) if exact.denominator < 10**_DIGITS else Number(Fraction(decimal_text(exact, _DIGITS)))
    if value.contains(0) and value.abs_upper() < arb(10) ** -30:
        return ZERO
    return Number(Fraction(decimal_text(arb_fraction(value.mid()), _DIGITS)))


def variables(word: str, *shape: int) -> Equations:
    """`word.0`, `word.1`, .. or `word.0.0`, .."""
    return _array(Variable(".".join(map(str, (word, *index)))) for index in np.ndindex(*shape)).reshape(shape)


def moduli(M: Equations) -> Equations:
    """|M|, entry by entry."""
    return _array(call("abs", value) for value in M.flat).reshape(M.shape)


def _array(values: Iterable[Expression]) -> Equations:
    return np.array(list(values), dtype=object)


def _zeros(count: int) -> Equations:
    return _array([ZERO] * count)


def _box(plant: Plant) -> tuple[Equations, Equations]:
    """The ends of the box of x(0)."""
    lower, upper = (_array(Variable(f"{end}.{name}") for name in plant.states) for end in ("lower", "upper"))
    return lower, upper


def _ends(box: Box | None, size: int) -> tuple[Equations, Equations]:
    if box is None:
        return _zeros(size), _zeros(size)
    return _array(value.expression for value in box.lower), _array(value.expression for value in box.upper)


def _middle(low: Equations, up: Equations) -> tuple[Equations, Equations]:
    """Middle and half width."""
    return (low + up) * _HALF, (up - low) * _HALF
