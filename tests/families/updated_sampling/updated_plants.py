"""Plants in triangular form that several tests share."""

from __future__ import annotations

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.plant import Domain, Input, Interval, Plant, Slopes
from cdobs_cli.sampling import SamplingLaw


def chain(
    n: int,
    phi: list[str],
    slopes: list[list[str]],
    inputs: dict[str, tuple[str, str]] | None = None,
    domain: Domain | None = None,
) -> Plant:
    """Lower triangular slopes |c_ij|, given as their moduli."""
    states = tuple(f"x{i + 1}" for i in range(n))
    known = tuple(Input(name, Interval(Exact(low), Exact(high))) for name, (low, high) in (inputs or {}).items())
    names = frozenset((*states, *(source.name for source in known)))
    A = ExactMatrix([[int(j == i + 1) for j in range(n)] for i in range(n)])
    upper = ExactMatrix(slopes)
    lower = ExactMatrix([[-entry for entry in row] for row in upper.rows])
    C = ExactMatrix([[int(j == 0) for j in range(n)]])
    expressions = tuple(parse(text, names) for text in phi)
    return Plant(
        states, known, A, expressions, None, C, Slopes(lower, upper), SamplingLaw("updated"), domain or Domain()
    )


def sines(n: int, c: str = "1") -> Plant:
    """phi_i = c sin(x_i): every slope on the diagonal up to c."""
    slopes = [[c if i == j else "0" for j in range(n)] for i in range(n)]
    return chain(n, [f"{c}*sin(x{i + 1})" for i in range(n)], slopes)


def last_row(n: int) -> Plant:
    """phi_n = sin(x_1)."""
    return chain(n, ["0"] * (n - 1) + ["sin(x1)"], [["0"] * n] * (n - 1) + [["1"] + ["0"] * (n - 1)])


def burst() -> Plant:
    """phi_2 = u sin(x_1), u in [0.2, 10]."""
    return chain(2, ["0", "u*sin(x1)"], [["0", "0"], ["10", "0"]], {"u": ("0.2", "10")})
