"""A change of coordinates: the plant in them, the way back, and what is claimed of both.

xdot = f(x, u) + d,  y = h(x) + v;   z = T(x):   zdot = A z + phi(z, u) + B u + (dT/dx) d,  y = C z + v
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from cdobs_cli.bounds.definedness import bounded_away, defined, defined_claim
from cdobs_cli.bounds.differ import Comparison, compared
from cdobs_cli.bounds.invariance import domain_invariant
from cdobs_cli.bounds.region import Region, point_witness
from cdobs_cli.certificate import Claim, ClaimKind
from cdobs_cli.coordinates.image import image_box, image_domain, image_of_disturbance
from cdobs_cli.coordinates.lie import lie_coordinates, lie_derivative
from cdobs_cli.coordinates.split import as_printed, automatic_slopes, linear_output, linear_part, linear_terms
from cdobs_cli.coordinates.typed import typed_plant, wrong_plant
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Expression, ExpressionError, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text
from cdobs_cli.exact.rational import simplify
from cdobs_cli.exact.solve import determinant, substituted
from cdobs_cli.hybrid import OriginalStates
from cdobs_cli.plant import Box, CoordinateMap, Domain, Interval, Plant, TypedDynamics
from cdobs_cli.records import dataclass
from cdobs_cli.run import ESTIMATE

if TYPE_CHECKING:
    from cdobs_cli.run import SimulationPlan

MAX_TRANSFORMED = 8
SOURCE = "cdobs, coordinates"


@dataclass(frozen=True)
class Coordinates:
    """z = map(x), x = inverse(z).

    Attributes:
        typed: the plant as the user typed it, states x.
        names: of z; `map` is over the states, `inverse` over the names.
        derived: A z + phi + B u as derived from f, over names and inputs.
        plant: what families see; its domain is a convex set that holds the image of the typed domain.
    """

    typed: TypedDynamics
    names: tuple[str, ...]
    map: tuple[Expression, ...]
    inverse: tuple[Expression, ...]
    derived: tuple[Expression, ...]
    plant: Plant = field(repr=False)

    @property
    def states(self) -> tuple[str, ...]:
        """The states that the user typed."""
        return self.typed.states

    @cached_property
    def region(self) -> Region:
        """The typed domain and the input ranges."""
        return Region.of(self.typed)

    @property
    def original(self) -> OriginalStates:
        """The user's states over those of the plant."""
        return OriginalStates(self.typed.domain, dict(zip(self.states, self.inverse, strict=True)))

    def original_values(self, z: NDArray[np.float64]) -> NDArray[np.float64]:
        """x along trajectories of z, shape (.., n); nan where the inverse has no value."""
        return _values(self.inverse, self.names, z)

    def new_values(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """z along trajectories of x, shape (.., n)."""
        return _values(self.map, self.states, x)

    def point(self, x: Sequence[Exact]) -> tuple[Exact, ...]:
        """z of one state x, exact."""
        env = {name: value.expression for name, value in zip(self.states, x, strict=True)}
        return tuple(Exact(simplify(one.substitute(env))) for one in self.map)

    def box(self, box: Box) -> Box:
        """A box of z that holds the image of a box of x."""
        ends = {name: Interval(low, high) for name, low, high in zip(self.states, box.lower, box.upper, strict=True)}
        return image_box(self.map, Region.made(ends, self.states, ()), ("simulation", "initial_box"))

    def plan(self, plan: SimulationPlan) -> SimulationPlan:
        """A simulation typed in the user's states, in the coordinates of the plant."""

        def moved(x: tuple[Exact, ...] | None, name: str) -> tuple[Exact, ...] | None:
            try:
                return None if x is None else self.point(x)
            except (ExpressionError, ZeroDivisionError):
                what, got = "the coordinates have no value there", ", ".join(map(str, x or ()))
                raise SpecError((Problem(("simulation", name), what, got),)) from None

        return replace(
            plan,
            initial_state=moved(plan.initial_state, "initial_state"),
            initial_estimate=moved(plan.initial_estimate, "initial_estimate"),
            initial_box=None if plan.initial_box is None else self.box(plan.initial_box),
            signals={name: signal.substitute(self._estimates) for name, signal in plan.signals.items()},
        )

    @property
    def _estimates(self) -> dict[str, Expression]:
        """The estimates of the user's states, made of those of the coordinates."""
        hat = {name: Variable(f"{ESTIMATE}{name}") for name in self.names}
        rows = substituted(self.inverse, hat)
        return {f"{ESTIMATE}{name}": row for name, row in zip(self.states, rows, strict=True)}

    def premises(self, claims: Sequence[Claim]) -> tuple[Claim, ...]:
        """The claims on the transformed plant, with what is claimed of the typed one and of the change itself.

        `domain_invariant` is judged in the typed states: the transformed domain is only a superset.
        """
        judged = tuple(defined(one, self.region) for one in self.typed.dynamics)
        own = [defined_claim(judged, self.region, "the typed dynamics"), self.inverse_claim(), self.diffeomorphism()]
        if self.typed.domain:
            own.append(domain_invariant(typed_plant(self.typed)))
        by_weight = (claim for status in ("refuted", "undecided") for claim in own[:3] if claim.status == status)
        worst = next(by_weight, None)
        kept = []
        for claim in claims:
            if claim.id == "defined":
                kept.append(replace(claim, id="defined.transformed"))
            elif worst is not None and claim.required and claim.status != "refuted":
                # The derived phi is the typed plant only where the change of coordinates is one.
                text = f"{claim.statement}: {worst.id} is {worst.status}"
                kept.append(replace(claim, status=worst.status, statement=text, margin=None, witness=worst.witness))
            elif claim.id != "domain_invariant":
                kept.append(claim)
        return (*kept, *own, *self.printed())

    def inverse_claim(self) -> Claim:
        """inverse(map(x)) = x over the typed domain."""
        back = substituted(self.inverse, dict(zip(self.names, self.map, strict=True)))
        text, found = "inverse(map(x)) = x", Comparison("proved")
        for name, one in zip(self.states, back, strict=True):
            found = compared(one, Variable(name), self.region)
            if found.status != "proved":
                text += f": {name} comes back as {one}" if found.point else f": not decided for {name}"
                break
        return _claim("coordinates.inverse", "premise", text, found)

    def diffeomorphism(self) -> Claim:
        """det dT/dx is bounded away from 0 over the typed domain."""
        jacobian = [[simplify(one.derivative(name)) for name in self.states] for one in self.map]
        det = simplify(determinant(jacobian))
        status, least, point = bounded_away(det, self.region)
        text = f"|det dT/dx| = |{det}| > 0 for {self.region.text()}"
        margin = fraction_text(least) if least is not None else None
        return Claim(
            "coordinates.diffeomorphism", "premise", status, text, SOURCE, margin=margin, method="branch and bound",
            witness=point_witness(point),
        )  # fmt: skip

    def printed(self) -> tuple[Claim, ...]:
        """Printed phi and C against the derived ones: an error is found, with a point."""
        claims = []
        typed, region = self.typed, Region.of(self.plant)
        for i, phi in enumerate(typed.phi or ()):
            found = compared(phi, self.plant.phi[i], region)
            text = f"the printed phi_{i + 1} = {phi} is the derived one"
            if found.status != "proved":
                text += f", {self.plant.phi[i]}"
            claims.append(_claim(f"printed.phi.{i + 1}", "printed", text, found))
        if typed.C is not None and typed.C != self.plant.C:
            text = f"the printed C is the derived one, {self.plant.C.texts()}"
            claims.append(_claim("printed.C", "printed", text, Comparison("refuted")))
        return tuple(claims)


def _claim(identifier: str, kind: ClaimKind, text: str, found: Comparison) -> Claim:
    return Claim(
        identifier, kind, found.status, text, SOURCE, method="canonical form", witness=point_witness(found.point),
    )  # fmt: skip


def _values(expressions: Sequence[Expression], names: Sequence[str], at: NDArray[np.float64]) -> NDArray[np.float64]:
    function = compile_floats(expressions, names, arrays=True)
    with np.errstate(all="ignore"):
        columns = function(*np.moveaxis(np.asarray(at, dtype=float), -1, 0))
    arrays = (np.asarray(column, dtype=float) for column in columns)
    return np.stack([np.broadcast_to(array, at.shape[:-1]) for array in arrays], axis=-1)


def transformed(typed: TypedDynamics, coordinates: CoordinateMap | Literal["lie"]) -> tuple[Plant, Coordinates]:
    """The plant in the coordinates, and the way back."""
    n = len(typed.states)
    if n > MAX_TRANSFORMED:
        raise wrong_plant("coordinates", f"at most {MAX_TRANSFORMED} states can be transformed", str(n))
    inputs = {source.name for source in typed.inputs}
    for k, one in enumerate(typed.output):
        if inputs & one.variables:
            what, hint = "with `coordinates` an output holds no input", "leave `coordinates` out"
            raise SpecError((Problem(("plant", "output", k), what, str(one), hint=hint),))
    change = lie_coordinates(typed) if coordinates == "lie" else coordinates
    back = dict(zip(typed.states, change.inverse, strict=True))
    rates = (lie_derivative(one, typed.states, typed.dynamics) for one in change.map)
    derived = substituted(tuple(rates), back)
    A = typed.A if typed.A is not None else _chain(n) if typed.coordinates == "lie" else ExactMatrix([[0] * n] * n)
    known = linear_terms(A, typed, change.names)
    phi = tuple(simplify(one - linear) for one, linear in zip(derived, known, strict=True))
    if typed.coordinates != "lie" and typed.A is None:
        A, phi = linear_part(phi, change.names)
    C = linear_output(substituted(typed.output, back), change.names)
    phi = as_printed(phi, typed.phi)
    region = Region.of(typed)
    domain = image_domain(change, region) if typed.domain else Domain()
    slopes = typed.slopes or automatic_slopes(phi, change.names)
    plant = Plant(
        change.names, typed.inputs, A, phi, typed.B, C, slopes, typed.sampling, domain,
        image_of_disturbance(typed, change, region), typed.noise, covariance=typed.covariance,
        delays=typed.delays,
    )  # fmt: skip
    return plant, Coordinates(typed, change.names, change.map, change.inverse, derived, plant)


def _chain(n: int) -> ExactMatrix:
    return ExactMatrix([[int(j == i + 1) for j in range(n)] for i in range(n)])
