"""The one search: it ends where the proofs end, and answers nothing where there is none."""

from fractions import Fraction

import pytest

from cdobs_cli.certify import search
from cdobs_cli.exact.numbers import Exact

WIDTH = Fraction(1, 1000)


def below(end):
    return lambda T: "yes" if float(T) < end else None


def test_between_bisects_on_proofs_only():
    T, proof = search.between(below(1.2345), Exact("0.001"), Exact(100), 1e-6)
    assert proof == "yes" and 1.2345 * (1 - 2e-6) < float(T) < 1.2345
    assert search.between(below(0), Exact(1), Exact(2), 1e-3) is None


def test_largest_walks_to_the_end_of_the_proofs():
    for start in ("5", "0.001"):
        T, proof = search.largest(below(0.7), Exact(start), WIDTH)
        assert proof == "yes" and 0.699 < float(T) < 0.7
    assert search.largest(below(0), Exact(5), WIDTH) is None


@pytest.mark.parametrize("said", [1.0, 0.999999, 0.5, 0.0])
def test_a_wrong_guess_of_where_a_refutation_ends_costs_little(said):
    """The least refuted number is 2; the guess says that the last one ends at this part of itself."""
    calls = []

    def refute(T):
        calls.append(float(T))
        return T if float(T) >= 2 else None

    found = search.smallest(refute, 1.0, 1.3, 1e-6, nearer=lambda _, T: said * T)
    assert found is not None and 2 <= float(found[0]) < 2 * (1 + 2e-6)
    assert len(calls) < 70
