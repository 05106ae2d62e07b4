import numpy as np
import pytest

from cdobs_cli.certify.blocks import BlockProgram
from cdobs_cli.certify.svec import full_basis, svec, symmetric_basis


def test_stacks_of_blocks_are_the_inequalities_that_they_say():
    """minimise trace P with P >= M_1, M_2: the least common upper bound of diag(1, 0) and diag(0, 1) is I."""
    program, basis = BlockProgram(3), symmetric_basis(2)
    columns = np.tile(np.arange(3), (2, 1))
    program.require(
        columns, np.broadcast_to(basis, (2, *basis.shape)), -np.array([np.diag([1.0, 0]), np.diag([0, 1.0])])
    )
    cost = np.array([np.trace(one) for one in basis])
    x = program.minimise(cost)
    assert x is not None and np.allclose(np.einsum("t,tij->ij", x, basis), np.eye(2), atol=1e-5)
    # One more inequality belongs to the copy alone; a column met twice counts twice.
    more = program.copy()
    more.require(np.array([[0, 0]]), np.ones((1, 2, 1, 1)), np.array([[-6.0]]))
    assert more.minimise(cost)[0] == pytest.approx(3, rel=1e-5) and program.minimise(cost)[0] == pytest.approx(
        1, rel=1e-5
    )
    more.at_least(-np.eye(3)[:1], [-2.0])
    assert more.minimise(cost) is None


def test_bases_are_orthonormal_in_the_order_of_the_solver():
    basis = symmetric_basis(3)
    assert np.allclose(svec(basis), np.eye(6))
    assert np.array_equal(full_basis(2, 3).sum(axis=0), np.ones((2, 3)))
