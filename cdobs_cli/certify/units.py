"""Units in which a search is well scaled: time in tau_max, each state in what an output integrates to.

Only searches use them; certificates are stored, and proved, in the user's units.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from cdobs_cli.hybrid import PlantView
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.arrays import Array

# A loop that survives its sampling is slower than it: with states in these units the certificates of chains
# of 7 and 8 integrators come out some thousand times better conditioned.
_SLOWER = 3.0


@dataclass(frozen=True)
class Units:
    """x = states z, y = outputs v, t = tau s: diagonals of shape (n,) and (p,), and the time unit.

    In these units the flow is tau D^-1 A D, the output E^-1 C D, the gain tau D^-1 L E, rates times tau.
    """

    states: Array
    outputs: Array
    tau: float

    @staticmethod
    def of(view: PlantView[Array], tau: float, slower: float = _SLOWER) -> Units:
        """Units for a plant: breadth first from the outputs along xdot_i = a_ij x_j, x_j counts in units of
        x_i / (slower tau |a_ij|), so that a chain of integrators becomes one with coefficients 1 / slower."""
        import numpy as np

        n = view.A.shape[0]
        coupling = np.abs(view.A)
        for part, low, high in zip(view.parts, view.lower, view.upper, strict=True):
            coupling = np.where(coupling == 0, np.abs(part) * max(abs(low), abs(high)), coupling)
        states = np.ones(n)
        measured = np.flatnonzero(np.abs(view.C).max(axis=0) > 0)
        seen = {int(i) for i in measured}
        front: list[int] = [int(i) for i in measured]
        while front:
            i = front.pop(0)
            for j in map(int, np.flatnonzero(coupling[i] > 0)):
                if j not in seen:
                    seen.add(j)
                    front.append(j)
                    states[j] = states[i] / (slower * tau * coupling[i, j])
        outputs = np.abs(view.C * states).max(axis=1)
        outputs[outputs == 0] = 1.0
        return Units(states, outputs, tau)

    def view(self, view: PlantView[Array]) -> PlantView[Array]:
        """The same plant and gain in these units."""
        D, E = self.states, self.outputs
        return replace(
            view,
            A=view.A * (self.tau * D / D[:, None]),
            C=view.C * D / E[:, None],
            gain={name: self.gain_in(L) for name, L in view.gain.items()},
            parts=tuple(part * (self.tau * D / D[:, None]) for part in view.parts),
        )

    def gain_in(self, L: Array) -> Array:
        """A gain of the user in these units, shape (n, p)."""
        return self.tau * L * self.outputs / self.states[:, None]

    def gain_out(self, L: Array) -> Array:
        """A gain of these units in the user's, shape (n, p)."""
        return L / self.outputs * self.states[:, None] / self.tau

    def states_out(self, P: Array) -> Array:
        """A quadratic form of the states in the user's units, shape (n, n)."""
        return P / self.states / self.states[:, None]

    def outputs_out(self, U: Array) -> Array:
        """A quadratic form of w that stands for w' U w dt, shape (p, p)."""
        return U / self.outputs / self.outputs[:, None] / self.tau
