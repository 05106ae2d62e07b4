"""Plants that tests of the nonlinearity make: only phi, slopes and a domain."""

from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.plant import Domain, Input, Interval, Plant, Slopes
from cdobs_cli.sampling import SamplingLaw


def interval(ends):
    return Interval(*(None if end is None else Exact(end) for end in ends))


def make_plant(states, phi, lower=None, upper=None, box=None, where=(), inputs=None, auto=()):
    """A plant with only a nonlinearity; slopes default to 0."""
    n = len(states)
    names = frozenset(states) | frozenset(inputs or {})
    zero = [["0"] * n for _ in range(n)]
    upper = upper or zero
    lower = lower or [[str(-Exact(entry).expression) for entry in row] for row in upper]
    return Plant(
        tuple(states),
        tuple(Input(name, interval(ends)) for name, ends in (inputs or {}).items()),
        ExactMatrix(zero),
        tuple(parse(text, names) for text in phi),
        None,
        ExactMatrix([["1"] + ["0"] * (n - 1)]),
        Slopes(ExactMatrix(lower), ExactMatrix(upper), frozenset(auto)),
        SamplingLaw.periodic(Exact("0.1")),
        Domain(
            {name: interval(ends) for name, ends in (box or {}).items()}, tuple(parse(text, names) for text in where)
        ),
    )
