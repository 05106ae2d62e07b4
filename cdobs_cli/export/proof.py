"""A proof that a sceptic checks: plant, gain, law and certificates as fractions, and a checker that stands alone."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from fractions import Fraction
from importlib.resources import files
from itertools import islice, product
from typing import Any, TypeAlias

from flint import arb, fmpq

from cdobs_cli.certificate import Certificate
from cdobs_cli.certify.kernel import kernel
from cdobs_cli.certify.methods.base import Question, read
from cdobs_cli.certify.methods.named import ACCURACY
from cdobs_cli.certify.texts import rationals
from cdobs_cli.design import Design
from cdobs_cli.errors import UsageError
from cdobs_cli.exact.matrix import Matrix
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fmpq_fraction, upper_text
from cdobs_cli.export.about import About
from cdobs_cli.export.check_proof import RefusedError, check
from cdobs_cli.families.base import Family
from cdobs_cli.families.constant_gain import ConstantGain
from cdobs_cli.hybrid import PlantView
from cdobs_cli.plant import Box, Plant
from cdobs_cli.sampling import SamplingLaw

CHECKER = "check_proof.py"
METHODS = ("clock", "set", "spectral_radius", "mean_square", "peak")
_KINDS = {"reachability": ("corrected", "K"), "lpv_zoh": ("held", "L")}
# Of the box of transitions: that of a chain of integrators, the exponential, or of so many steps, which is wider.
_STEPS = (0, 1, 16, 256)
_MOST_STATES = 6  # of a box, of whose members 2^(2 n - 1) count
_SHARES = (1 / 16, 1 / 2)  # of what lies between the square of the spectral radius and 1
_ROOM = Fraction(1, 10**9)  # by which a stated bound is above the certificate's own, which roots and decimals round

Rows: TypeAlias = list[list[str]]


class _NoFractionError(Exception):
    """A number that is no fraction."""


def proof_files(about: About, card: Family, plant: Plant, design: Design) -> dict[str, str]:
    """proof.json and the checker: of the certificates of the design's own gain those of `METHODS` that hold.

    Raises:
        UsageError: nothing of the design can be checked with fractions alone.
    """
    question, chosen = None, list[tuple[Certificate, arb | None]]()
    if isinstance(card, ConstantGain) and design.family in _KINDS and not design.sampling.has_sensors:
        question = card.question(replace(plant, sampling=design.sampling), design.gain, 0)
        chosen = list(_proved(card, question, design))
    if question is None or not chosen:
        held = ", ".join(dict.fromkeys(one.method for one in design.certificates)) or "none"
        raise UsageError(
            f"a proof is written of certificates by {', '.join(METHODS)} of one gain; this design of family "
            f"{design.family} has certificates by {held}"
        )
    if plant.delays:
        raise UsageError(
            "a proof is written of samples that are there at once; what is late is proved by `cdobs check`"
        )
    kind, letter = _KINDS[design.family]
    if kind == "held" and plant.output_quantities:
        raise UsageError("a proof with a held innovation is written of linear outputs only")
    try:
        document: dict[str, Any] = {
            "schema_version": 1, "title": about.title, "verdict": about.verdict, "told": list(about.told),
            "digests": dict(about.digests), "time_unit": about.labels.time, "observer": kind,
            "plant": _plant(plant), "gain": _rows(design.gain[letter]), "certificates": [],
        }  # fmt: skip
        for one, bound in chosen:
            tried = _tried(one, bound, question)
            document["certificates"] += list(islice((each for each in tried if _holds(document, each)), 1))
    except _NoFractionError as error:
        raise UsageError(f"a proof holds fractions only: {error}") from error
    if not document["certificates"]:
        raise UsageError(
            "the matrices that the checker finds by itself, in short steps, are too many for this period, or there are "
            f"more than {_MOST_STATES} states"
        )
    checker = files(__package__).joinpath(CHECKER).read_text(encoding="utf-8")
    return {"proof/proof.json": json.dumps(document, indent=1) + "\n", f"proof/{CHECKER}": checker}


def _proved(card: ConstantGain, question: Question, design: Design) -> Iterator[tuple[Certificate, arb | None]]:
    """Certificates that hold, and the bound of an error that each proves."""
    for one in design.certificates:
        if one.method not in METHODS or card.letter in one.data:
            continue
        stored = read(one, (*card.methods(), *ACCURACY), (card.letter,))
        proof = None if stored is None else stored.method.prove(question)
        if proof is not None and proof.holds:
            yield one, proof.error


def _tried(one: Certificate, bound: arb | None, question: Question) -> Iterable[dict[str, Any]]:
    """How a certificate may be written; the first that the checker takes is."""
    if one.method == "set":
        return _sets(one, question.plant, question.gain("K")) if question.plant.n <= _MOST_STATES else []
    return _radii(one, question) if one.method == "spectral_radius" else [_certificate(one, bound)]


def _holds(document: dict[str, Any], certificate: dict[str, Any]) -> bool:
    """Whether the checker says so; of other methods than sets it is not asked, as nothing is tried there."""
    try:
        return certificate["method"] != "set" or bool(check(document | {"certificates": [certificate]}))
    except RefusedError:
        return False


def _plant(plant: Plant) -> dict[str, Any]:
    view = PlantView.balls(plant, {})
    C = view.C
    for part, low, high in zip(view.outputs, view.output_lower, view.output_upper, strict=True):
        C = C - part * ((low + high) / 2)
    return {
        "states": list(plant.states), "phi": [str(row) for row in plant.phi],
        "A": _fractions(view.A), "C": _fractions(C),
        "slopes": _slopes(view.parts, view.lower, view.upper),
        "outputs": _slopes(view.outputs, view.output_lower, view.output_upper),
        "disturbance": _sizes(plant.disturbance, plant.n), "noise": _sizes(plant.noise, plant.p),
        "intensity": _covariance(plant.intensity, plant.n), "covariance": _covariance(plant.covariance, plant.p),
    }  # fmt: skip


def _slopes(parts: tuple[Matrix, ...], lower: tuple[Any, ...], upper: tuple[Any, ...]) -> list[dict[str, Any]]:
    return [
        {"part": _fractions(part), "lower": _fraction(low), "upper": _fraction(high)}
        for part, low, high in zip(parts, lower, upper, strict=True)
    ]


def _sizes(box: Box | None, length: int) -> list[str]:
    return ["0"] * length if box is None else [_fraction(size) for size in box.sizes]


def _covariance(M: ExactMatrix | None, size: int) -> list[list[str]]:
    return _upper(Matrix.zeros(size, size) if M is None else M.balls())


def _upper(M: Matrix) -> list[list[str]]:
    """The upper triangle, each row from the diagonal on."""
    return [row[i:] for i, row in enumerate(_fractions(M))]


def _rows(M: ExactMatrix) -> list[list[str]]:
    return _fractions(M.balls())


def _fractions(M: Matrix) -> list[list[str]]:
    return [[_fraction(value) for value in row] for row in M.tolist()]


def _fraction(value: Any) -> str:
    if isinstance(value, int):
        return str(value)
    if not isinstance(value, fmpq):
        raise _NoFractionError(f"about {float(arb(value).mid()):.6g} is none")
    return str(fmpq_fraction(value))


def _text(text: str) -> str:
    exact = Exact(text).rational
    if exact is None:
        raise _NoFractionError(f"{text} is none")
    return str(exact)


def _texts(value: Any) -> Any:
    """Decimals, however deep they stand."""
    return _text(value) if isinstance(value, str) else [_texts(one) for one in value]


def _certificate(one: Certificate, bound: arb | None) -> dict[str, Any]:
    data = one.data
    if one.method == "clock":
        written = {
            "degrees": [int(data["degree"]), int(data["elevated"])], "pieces": list(map(int, data["pieces"])),
            "sigma": _text(data["sigma"]), "basis": _texts(data["basis"]),
            "inverse": _fractions(rationals(data["basis"]).inverse()), "P": _texts(data["P"]),
        }  # fmt: skip
    elif one.method == "mean_square":
        d, D, before, after = map(int, data["shape"])
        units = [Fraction(_text(unit)) for unit in data["units"]]
        P = [
            [
                [str(Fraction(_text(text)) / (units[i] * units[i + k])) for k, text in enumerate(row)]
                for i, row in enumerate(one_P)
            ]
            for one_P in data["P"]
        ]
        written = {"degrees": [d, D], "pieces": [before, after], "P": P}
    else:
        start = data.get("start")
        chains = [_chain(chain) for chain in data["chains"]]
        written = {"state": int(data["state"]), "start": None if start is None else _texts(start), "chains": chains}
    if bound is not None:
        written["bound"] = str((Exact(upper_text(bound)).rational or Fraction(0)) * (1 + _ROOM))
    return {"method": one.method, "law": _law(one.sampling), "data": written}


def _sets(one: Certificate, plant: Plant, K: ExactMatrix) -> Iterator[dict[str, Any]]:
    """A certificate of a set as e = S z after samples, I - K C = S T and z'Q z. The checker's box lies in the set, or
    is a little wider: then with a slower fall.

    A typed set is not written: it holds the box of the plant's structure, and inequalities at its members hold there.
    """
    space, jump = kernel(plant.C), Matrix.identity(plant.n) - K.balls() @ plant.C.balls()
    fall = Fraction(_text(one.data["rho_squared"]))
    if one.data["form"] == "full" or not space.dimension:
        S, T = Matrix.identity(plant.n), jump
        Q = ExactMatrix(one.data["P"]).balls() if space.dimension else S
        fall = fall if space.dimension else Fraction(1, 2)
    else:
        S, T, Q = space.N, space.R @ jump, ExactMatrix(one.data["Q"]).balls()
    for steps, rho_squared in product(_STEPS, (fall, (1 + fall) / 2)):
        yield _set(one, _fractions(S), _fractions(T), _upper(Q), rho_squared, steps)


def _radii(one: Certificate, question: Question) -> Iterator[dict[str, Any]]:
    """Of a linear loop with error map J exp(A T): a form that falls by less than the square of the spectral radius."""
    import numpy as np
    from scipy.linalg import expm, solve_discrete_lyapunov

    maps = question.inclusion.phases_balls[0]
    J, N = maps.jump, maps.jump.shape[0]
    F = J.floats @ expm(maps.base.floats * float(one.sampling.T_max))
    if N > _MOST_STATES or not np.all(np.isfinite(F)):
        return
    radius = float(max(abs(np.linalg.eigvals(F)))) ** 2
    for share, steps in product(_SHARES, _STEPS[1:]):
        fall = Fraction(radius + share * (1 - radius))
        P = solve_discrete_lyapunov(F.T / np.sqrt(float(fall)), np.eye(N)) if fall < 1 else np.full((N, N), np.nan)
        if np.all(np.isfinite(P)):
            Q = [[str(Fraction(float(P[i, j]))) for j in range(i, N)] for i in range(N)]
            yield _set(one, _fractions(Matrix.identity(N)), _fractions(J), Q, fall, steps)


def _set(one: Certificate, S: Rows, T: Rows, Q: Rows, rho_squared: Fraction, steps: int) -> dict[str, Any]:
    data = {"S": S, "T": T, "Q": Q, "steps": steps, "rho_squared": str(rho_squared)}
    return {"method": "set", "law": _law(one.sampling), "data": data}


def _chain(chain: dict[str, Any]) -> dict[str, Any]:
    return {
        "window": _texts(chain["window"]), "degrees": [int(chain["degree"]), int(chain["elevated"])],
        "pieces": [list(map(int, one)) for one in chain["pieces"]], "rho": _text(chain["rho"]),
        "P": _texts(chain["P"]), "mu": _texts(chain["mu"]), "nu": _texts(chain["nu"]),
    }  # fmt: skip


def _law(law: SamplingLaw) -> dict[str, Any]:
    ends = {"T_min": _text(str(law.T_min)), "T_max": _text(str(law.T_max))}
    return ends | {"lost": law.lost, "probability": _text(str(law.probability))}
