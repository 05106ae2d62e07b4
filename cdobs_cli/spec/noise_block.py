"""The blocks `measurement.noise` and `plant.disturbance`: what is known of v_k and d(t), in one of a few kinds."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar

from pydantic import ConfigDict, Field

from cdobs_cli.errors import Problem
from cdobs_cli.exact.budget import spend
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.fields import MAX_ROWS, NonNegativeNumber, Rows, Vector, sized
from cdobs_cli.plant import Box
from cdobs_cli.spec.block import Block
from cdobs_cli.spec.boxes import BoxBlock, box_problems, shape_problem
from cdobs_cli.spec.reader import FieldPath

LONGEST_SHOWN = 200  # characters of a matrix in a message
_BITS = 800  # of a number, with which an operation on it costs as much as on a short one


def _kinds(*kinds: list[str]) -> dict[str, Any]:
    """For editors: the keys of exactly one kind."""
    return {"oneOf": [{"required": keys} for keys in kinds]}


class _UncertainBlock(Block):
    """A box, or a second moment: keys of exactly one kind."""

    kinds: ClassVar[dict[str, str]]
    what: ClassVar[str]

    lower: Annotated[Vector | None, Field(description="With `upper`: the ends of a box, a number each.")] = None
    upper: Annotated[Vector | None, Field(description="With `lower`: the ends of a box, a number each.")] = None

    @property
    def typed_kinds(self) -> list[str]:
        """The kinds of which a key was typed, by how they are typed."""
        return list(dict.fromkeys(text for name, text in self.kinds.items() if getattr(self, name) is not None))

    @property
    def box(self) -> Box | None:
        """Once nothing is wrong; None of another kind."""
        return None if self.lower is None or self.upper is None else Box(self.lower, self.upper)


class NoiseBlock(_UncertainBlock):
    """v_k in a box, or of mean 0 and a covariance; `std` is its diagonal of deviations."""

    model_config = ConfigDict(json_schema_extra=_kinds(["lower", "upper"], ["covariance"], ["std"]))
    kinds: ClassVar[dict[str, str]] = {
        "lower": "{lower: [..], upper: [..]}", "upper": "{lower: [..], upper: [..]}",
        "covariance": "{covariance: [[..]]}", "std": "{std: [..]}",
    }  # fmt: skip
    what: ClassVar[str] = "noise"

    covariance: Annotated[
        Rows | None, Field(description="E v_k v_k', symmetric and positive semidefinite: normal, independent.")
    ] = None
    std: Annotated[
        Annotated[tuple[NonNegativeNumber, ...], sized(1, MAX_ROWS)] | None,
        Field(description="Standard deviations, one for each output: a diagonal covariance."),
    ] = None

    @property
    def second_moment(self) -> ExactMatrix | None:
        """E v_k v_k', shape (p, p); None of a box."""
        if self.std is None:
            return self.covariance
        return ExactMatrix.diagonal([sigma * sigma for sigma in self.std])


class DisturbanceBlock(_UncertainBlock):
    """d(t) in a box, or white of an intensity: the covariance of its integral over a unit of time."""

    model_config = ConfigDict(json_schema_extra=_kinds(["lower", "upper"], ["intensity"]))
    kinds: ClassVar[dict[str, str]] = {
        "lower": "{lower: [..], upper: [..]}", "upper": "{lower: [..], upper: [..]}",
        "intensity": "{intensity: [[..]]}",
    }  # fmt: skip
    what: ClassVar[str] = "disturbance"

    intensity: Annotated[
        Rows | None,
        Field(description="Of a white d: the covariance of its integral, per unit of time, positive semidefinite."),
    ] = None


def noise_problems(block: NoiseBlock, at: FieldPath, p: int | None) -> Iterator[Problem]:
    """One kind, of p outputs."""
    yield from _kind_problems(block, at, p, "output")
    if block.covariance is not None:
        yield from _moment_problems(block.covariance, (*at, "covariance"), p, "output")
    if block.std is not None and p is not None and len(block.std) != p:
        what = "one number for each output is expected"
        yield Problem((*at, "std"), what, f"{len(block.std)} numbers", f"{p} numbers")


def disturbance_problems(block: DisturbanceBlock, at: FieldPath, n: int | None, *, moved: bool) -> Iterator[Problem]:
    """One kind, of n states; moved: whether the plant is brought to other coordinates."""
    yield from _kind_problems(block, at, n, "state")
    if block.intensity is None:
        return
    yield from _moment_problems(block.intensity, (*at, "intensity"), n, "state")
    if moved:
        what = "a white disturbance does not go with `coordinates`: in them its intensity would depend on the state"
        yield Problem((*at, "intensity"), what, hint="leave `coordinates` out, or bound it: {lower: [..], upper: [..]}")


def _kind_problems(
    block: NoiseBlock | DisturbanceBlock, at: FieldPath, length: int | None, of: str
) -> Iterator[Problem]:
    typed, allowed = block.typed_kinds, list(dict.fromkeys(block.kinds.values()))
    told = f"{', '.join(allowed[:-1])} or {allowed[-1]}"
    if len(typed) > 1:
        yield Problem(at, f"one kind of {block.what} is expected, these are {len(typed)}", " and ".join(typed), told)
    elif not typed:
        yield Problem(at, f"a kind of {block.what} is expected", None, told)
    elif block.lower is not None or block.upper is not None:
        yield from box_problems(BoxBlock(lower=block.lower, upper=block.upper), at, length, of)


def _moment_problems(M: ExactMatrix, at: FieldPath, size: int | None, of: str) -> Iterator[Problem]:
    """M (size, size), symmetric and positive semidefinite, decided exactly."""
    rows, columns = M.shape
    if size is not None and (rows, columns) != (size, size):
        yield from shape_problem(at, M.shape, (size, size), f"a row and a column for each {of}")
        return
    if rows != columns:
        yield from shape_problem(at, M.shape, (rows, rows), f"a row and a column for each {of}")
        return
    for i in range(rows):
        for j in range(i):
            if M[i, j] != M[j, i] and (M[i, j] - M[j, i]).sign() != 0:
                what = f"a symmetric matrix is expected: this is not the entry of row {j + 1}, column {i + 1}"
                yield Problem((*at, i, j), what, str(M[i, j]), str(M[j, i]))
                return
    for i in range(rows):
        if M[i, i].sign() == -1:
            yield Problem((*at, i, i), "a variance is not negative", str(M[i, i]), "0 or more")
            return
    if rows == 1 or all(M[i, j].sign() == 0 for i in range(rows) for j in range(i)):
        return
    spend(rows**3 * (1 + rows * _longest(M) // _BITS))
    from cdobs_cli.certify.definite import is_semidefinite

    judged = is_semidefinite(M.balls())
    if judged is None:
        what, hint = "is not shown to be positive semidefinite", "write its entries as decimals or fractions"
        yield Problem(at, what, _shown(M), hint=hint)
    elif not judged:
        hint = "each |m_ij| is at most sqrt(m_ii m_jj), and so on: no combination has a negative variance"
        yield Problem(at, "is not positive semidefinite", _shown(M), hint=hint)


def _longest(M: ExactMatrix) -> int:
    """Bits of the longest entry."""
    numbers = [entry.rational for row in M.rows for entry in row]
    return max((n.numerator.bit_length() + n.denominator.bit_length() for n in numbers if n is not None), default=0)


def _shown(M: ExactMatrix) -> str:
    rows = ", ".join(f"[{', '.join(row)}]" for row in M.texts())
    text = f"[{rows}]"
    return text if len(text) <= LONGEST_SHOWN else f"{text[: LONGEST_SHOWN - 3]}..."
