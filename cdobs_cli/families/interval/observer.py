"""The interval observer (12), (13) and the hull predictor as equations, and the system of their errors.

Derived coefficients (S^-1, S A S^-1, ..) are written as decimals of 20 digits; the proofs read the typed
matrices.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from cdobs_cli.design import Design
from cdobs_cli.exact.expression import ZERO, Expression, Number, Variable, call
from cdobs_cli.exact.matrix import Matrix, block
from cdobs_cli.exact.numbers import ExactMatrix, arb_fraction, decimal_text
from cdobs_cli.families.interval.held_loop import closed_maps
from cdobs_cli.families.interval.intersect import measured_rows
from cdobs_cli.families.interval.parts import absolute, identity_like, metzler_split, negative_part, positive_part, zeros_like
from cdobs_cli.families.interval.theorems import coordinates, error_flow, error_held
from cdobs_cli.hybrid import ErrorMaps, HybridInclusion, Observer, PlantView
from cdobs_cli.plant import Box, Plant

_DIGITS = 20
Rows = list[list[Expression]]


def interval_observer(plant: Plant, design: Design, *, intersect: bool) -> Observer:
    """Two copies of the model in z = S x, one for each bound; what acts from a sample to the next is held.

        z_lower' = P z_lower - N z_upper + S B u + g_lower,    z_upper' = P z_upper - N z_lower + S B u + g_upper
        g_lower  = P1 z_lower(t_k) - N1 z_upper(t_k) + S L y_k + delta_lower   (g_upper likewise)
        x_lower  = (S^-1)^+ z_lower - (S^-1)^- z_upper                          (x_upper likewise)

    Source: Efimov2016, (12), (13)
    Deviates: the diagonal of S A S^-1 is not split; with `intersect`, measured rows of z are cut to what y_k
        and the bounds of the noise leave at a sample.
    """
    n, p = plant.n, plant.p
    S = design.gain["S"].balls()
    z = coordinates(plant.A.balls(), plant.C.balls(), S, S.inverse(), design.gain["L"].balls())
    P, N = (numbers(part) for part in metzler_split(z.Q0))
    P1, N1 = (numbers(part) for part in metzler_split(z.Q1))
    SL = numbers(z.SL)
    low, up, g_low, g_up = (_names(word, n) for word in ("z_lower", "z_upper", "g_lower", "g_upper"))
    y = _variables(_names("y", p))
    x_lower, x_upper = (_variables([f"{end}.{name}" for name in plant.states]) for end in ("lower", "upper"))

    start_low, start_up = enclosure(S, x_lower, x_upper)
    delta_low, delta_up = _delta(plant, S, z.SL)
    known = _known_input(plant, S)
    at_low, at_up = list(_variables(low)), list(_variables(up))
    if intersect:
        for i, G in measured_rows(plant.C.balls(), S).items():
            inner_low, inner_up = _measured(G, y, plant.noise)
            at_low[i], at_up[i] = call("max", at_low[i], inner_low), call("min", at_up[i], inner_up)
    injected = product(SL, y)
    held_low = [_sum(a, -b, c, d) for a, b, c, d in zip(product(P1, at_low), product(N1, at_up), injected, delta_low, strict=True)]
    held_up = [_sum(a, -b, c, d) for a, b, c, d in zip(product(P1, at_up), product(N1, at_low), injected, delta_up, strict=True)]
    Z_low, Z_up = _variables(low), _variables(up)
    flow_low = [_sum(a, -b, c, Variable(g)) for a, b, c, g in zip(product(P, Z_low), product(N, Z_up), known, g_low, strict=True)]
    flow_up = [_sum(a, -b, c, Variable(g)) for a, b, c, g in zip(product(P, Z_up), product(N, Z_low), known, g_up, strict=True)]
    out_low, out_up = enclosure(z.R, Z_low, Z_up)
    still = [ZERO] * (2 * n)
    return Observer(
        states=(*low, *up, *g_low, *g_up),
        start=(*start_low, *start_up, *still),
        flow=(*flow_low, *flow_up, *still),
        jump=(*at_low, *at_up, *held_low, *held_up),
        estimates={"x_lower": tuple(out_low), "x_upper": tuple(out_up)},
        control=_control(plant, design, Z_low, Z_up),
    )


def hull_observer(plant: Plant, design: Design) -> Observer:
    """The hull predictor: centre c, radius rho at samples in z = S x, and the maps exp(A s), Gamma_A(s) L and
    integrals of moduli since the last sample.

        |x - c| <= |F(s) S^-1| rho + integral |exp(A r)| d_rad + |Gamma_A(s) L| v_rad,   F = exp(A s) - Gamma_A L C
    """
    n, p = plant.n, plant.p
    A, S, L, C = plant.A.balls(), design.gain["S"].balls(), design.gain["L"].balls(), plant.C.balls()
    R = S.inverse()
    c, g, rho, in_x, in_z = (_names(word, n) for word in ("c", "g", "rho", "in_x", "in_z"))
    E, H = [[f"exp.{i}.{j}" for j in range(n)] for i in range(n)], [[f"gain.{i}.{k}" for k in range(p)] for i in range(n)]
    E_rows, H_rows = [list(_variables(row)) for row in E], [list(_variables(row)) for row in H]
    d_mid, d_rad = _middle(plant.disturbance, n)
    v_mid, v_rad = _middle(plant.noise, p)
    y, centre, radius = _variables(_names("y", p)), _variables(c), _variables(rho)
    x_lower, x_upper = (_variables([f"{end}.{name}" for name in plant.states]) for end in ("lower", "upper"))
    half = Number(Fraction(1, 2))

    exact_A, exact_L, exact_C, exact_S, exact_R = (numbers(M) for M in (A, L, C, S, R))
    innovation = [_sum(a, -b, -v) for a, b, v in zip(y, product(exact_C, centre), v_mid, strict=True)]
    known = _known_input(plant, Matrix.identity(n))
    flow_c = [_sum(a, b, Variable(name), d) for a, b, name, d in zip(product(exact_A, centre), known, g, d_mid, strict=True)]
    flow_E = compose(exact_A, E_rows)
    flow_H = [[a + b for a, b in zip(row, gain, strict=True)] for row, gain in zip(compose(exact_A, H_rows), exact_L, strict=True)]
    F = [[a - b for a, b in zip(row, cut, strict=True)] for row, cut in zip(E_rows, compose(H_rows, exact_C), strict=True)]
    FR = compose(F, exact_R)
    SFR = compose(exact_S, FR)
    spread = [_sum(a, Variable(b), v) for a, b, v in zip(product(moduli(FR), radius), in_x, product(moduli(H_rows), v_rad), strict=True)]
    next_rho = [
        _sum(a, Variable(b), v)
        for a, b, v in zip(product(moduli(SFR), radius), in_z, product(moduli(compose(exact_S, H_rows)), v_rad), strict=True)
    ]
    identity = [[Number(int(i == j)) for j in range(n)] for i in range(n)]
    states = (*c, *g, *rho, *in_x, *in_z, *_flat(E), *_flat(H))
    nothing = [ZERO] * n
    at_sample_z = product(exact_S, centre)
    return Observer(
        states=states,
        start=(
            *[(a + b) * half for a, b in zip(x_lower, x_upper, strict=True)], *nothing,
            *product(numbers(absolute(S)), [(b - a) * half for a, b in zip(x_lower, x_upper, strict=True)]), *nothing, *nothing,
            *_flat(identity), *[ZERO] * (n * p),
        ),
        flow=(
            *flow_c, *nothing, *nothing, *product(moduli(E_rows), d_rad), *product(moduli(compose(exact_S, E_rows)), d_rad),
            *_flat(flow_E), *_flat(flow_H),
        ),
        jump=(*centre, *product(exact_L, innovation), *next_rho, *nothing, *nothing, *_flat(identity), *[ZERO] * (n * p)),
        estimates={
            "x_lower": tuple(a - b for a, b in zip(centre, spread, strict=True)),
            "x_upper": tuple(a + b for a, b in zip(centre, spread, strict=True)),
        },
        control=_control(
            plant, design, [a - b for a, b in zip(at_sample_z, radius, strict=True)],
            [a + b for a, b in zip(at_sample_z, radius, strict=True)],
        ),
    )  # fmt: skip


def enclosure(S: Matrix, lower: Sequence[Expression], upper: Sequence[Expression]) -> tuple[list[Expression], list[Expression]]:
    """S^+ lower - S^- upper and S^+ upper - S^- lower: the box of S x.

    Source: Efimov2016, (1)
    """
    plus, minus = numbers(positive_part(S)), numbers(negative_part(S))
    low = [a - b for a, b in zip(product(plus, lower), product(minus, upper), strict=True)]
    up = [a - b for a, b in zip(product(plus, upper), product(minus, lower), strict=True)]
    return low, up


def _delta(plant: Plant, S: Matrix, SL: Matrix) -> tuple[list[Expression], list[Expression]]:
    """The box of delta = S d - S L v."""
    low_d, up_d = enclosure(S, *_ends(plant.disturbance, plant.n))
    low_v, up_v = enclosure(SL, *_ends(plant.noise, plant.p))
    return [a - b for a, b in zip(low_d, up_v, strict=True)], [a - b for a, b in zip(up_d, low_v, strict=True)]


def _measured(G: Matrix, y: Sequence[Expression], noise: Box | None) -> tuple[Expression, Expression]:
    """The interval of G C x when y = C x + v."""
    low_v, up_v = enclosure(G, *_ends(noise, len(y)))
    value = product(numbers(G), y)[0]
    return value - up_v[0], value - low_v[0]


def _known_input(plant: Plant, S: Matrix) -> list[Expression]:
    """S (B u + phi(u))."""
    terms: list[Expression] = []
    for i in range(plant.n):
        total = plant.phi[i]
        if plant.B is not None:
            for j, source in enumerate(plant.inputs):
                total = total + plant.B[i, j].expression * Variable(source.name)
        terms.append(total)
    return product(numbers(S), terms)


def _control(plant: Plant, design: Design, z_lower: Sequence[Expression], z_upper: Sequence[Expression]) -> dict[str, Expression]:
    """u = K_lower z_lower + K_upper z_upper, where the design has feedback.

    Source: Efimov2016, (16)
    """
    if "K_lower" not in design.gain:
        return {}
    lower = product(numbers(design.gain["K_lower"].balls()), z_lower)
    upper = product(numbers(design.gain["K_upper"].balls()), z_upper)
    return {source.name: a + b for source, a, b in zip(plant.inputs, lower, upper, strict=True)}


def error_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """The errors of the bounds with what is held of them: (e, e(t_k))' = [M N1; 0 0], and e(t_k)+ = e.

    Source: Efimov2016, (11), (12)
    """
    S: Any = view.gain["S"]
    R = S.inverse() if isinstance(S, Matrix) else np.linalg.inv(S)
    z = coordinates(view.A, view.C, S, R, view.gain["L"])
    M, N1 = error_flow(z.Q0), error_held(z.Q1)
    zero, identity = zeros_like(M, *M.shape), identity_like(M, M.shape[0])
    jump: Any = block([[identity, zero], [identity, zero]])
    return ErrorMaps(base=block([[M, N1], [zero, zero]]), left=(), right=(), lower=(), upper=(), jump=jump)


def closed_error_maps(view: PlantView[Any]) -> ErrorMaps[Any]:
    """The errors with the plant and its feedback.

    Source: Efimov2016, (16), (17)
    """
    return closed_maps(view, error_maps(view))


def inclusion(plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
    """The error system of both bounds with given S and L under the plant's sampling law; with feedback in the
    gain, together with the plant it closes."""
    if "K_lower" in gain and plant.B is not None:
        return HybridInclusion(closed_error_maps, plant, {**gain, "B": plant.B}, plant.sampling, ())
    return HybridInclusion(error_maps, plant, gain, plant.sampling, ())


# ---------------------------------------------------------------- matrices of expressions


def numbers(M: Matrix) -> Rows:
    """The entries as numbers: exact where they are short rationals, decimals of 20 digits otherwise."""
    return [[_number(value) for value in row] for row in M.tolist()]


def _number(value: Any) -> Expression:
    if not isinstance(value, arb):
        exact = Fraction(int(value.p), int(value.q))
        return Number(exact) if exact.denominator < 10**_DIGITS else Number(Fraction(decimal_text(exact, _DIGITS)))
    if value.contains(0) and value.abs_upper() < arb(10) ** -30:
        return ZERO
    return Number(Fraction(decimal_text(arb_fraction(value.mid()), _DIGITS)))


def product(M: Rows, vector: Sequence[Expression]) -> list[Expression]:
    """M times a vector."""
    return [_sum(*(a * b for a, b in zip(row, vector, strict=True))) for row in M]


def compose(A: Rows, B: Rows) -> Rows:
    """A times B."""
    return [list(row) for row in zip(*(product(A, column) for column in zip(*B, strict=True)), strict=True)]


def moduli(M: Rows) -> Rows:
    """|M|, entry by entry."""
    return [[call("abs", value) for value in row] for row in M]


def _sum(*terms: Expression) -> Expression:
    total: Expression = ZERO
    for term in terms:
        total = total + term
    return total


def _names(word: str, count: int) -> list[str]:
    return [f"{word}.{k}" for k in range(count)]


def _variables(names: Sequence[str]) -> list[Expression]:
    return [Variable(name) for name in names]


def _ends(box: Box | None, size: int) -> tuple[list[Expression], list[Expression]]:
    if box is None:
        return [ZERO] * size, [ZERO] * size
    return [value.expression for value in box.lower], [value.expression for value in box.upper]


def _middle(box: Box | None, size: int) -> tuple[list[Expression], list[Expression]]:
    low, up = _ends(box, size)
    half = Number(Fraction(1, 2))
    return [(a + b) * half for a, b in zip(low, up, strict=True)], [(b - a) * half for a, b in zip(low, up, strict=True)]


def _flat(rows: Sequence[Sequence[Any]]) -> list[Any]:
    return [value for row in rows for value in row]
