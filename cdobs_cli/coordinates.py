"""Typed dynamics made a Plant, and the way back to the user's states.

    xdot = f(x, u) + d,  y = h(x) + v;   z = T(x):   zdot = A z + phi(z, u) + B u + (dT/dx) d,  y = C z + v

With `coordinates: lie`, T = (h, L_f h, .., L_f^(n-1) h) along the drift f(x, 0): A is a chain of integrators
and C = [1 0 .. 0]. Families see only the Plant.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from math import isfinite
from typing import TYPE_CHECKING

from cdobs_cli.bounds.bounded import TRIAL, least_bound
from cdobs_cli.bounds.definedness import defined, defined_claim
from cdobs_cli.bounds.differ import Comparison, compared
from cdobs_cli.bounds.invariance import domain_invariant
from cdobs_cli.bounds.region import Region, point_text
from cdobs_cli.certificate import Claim, Status, Witness
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.expression import ZERO, Expression, ExpressionError, Number, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix, fraction_text
from cdobs_cli.exact.rational import simplify
from cdobs_cli.exact.solve import determinant, solve, substituted
from cdobs_cli.plant import Box, CoordinateMap, Domain, Interval, Plant, Slopes, TypedDynamics

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.run import SimulationPlan

MAX_TRANSFORMED = 8
SOURCE = "cdobs, coordinates"
# Images are supersets in any case: a hundredth of their width is close enough.
COARSE = 0.01


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
        return _typed_region(self.typed)

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
        return _image(self.map, Region.made(ends, self.states, ()), ("simulation", "initial_box"))

    def plan(self, plan: SimulationPlan) -> SimulationPlan:
        """A simulation typed in the user's states, in the coordinates of the plant."""

        def moved(x: tuple[Exact, ...] | None, name: str) -> tuple[Exact, ...] | None:
            try:
                return None if x is None else self.point(x)
            except (ExpressionError, ZeroDivisionError):
                what = "the coordinates have no value there"
                raise SpecError((Problem(("simulation", name), what, ", ".join(str(value) for value in x or ())),)) from None

        return replace(
            plan,
            initial_state=moved(plan.initial_state, "initial_state"),
            initial_estimate=moved(plan.initial_estimate, "initial_estimate"),
            initial_box=None if plan.initial_box is None else self.box(plan.initial_box),
        )

    def premises(self, claims: Sequence[Claim]) -> tuple[Claim, ...]:
        """The claims on the transformed plant, with what is claimed of the typed one and of the change itself.

        `domain_invariant` is judged in the typed states: the transformed domain is only a superset.
        """
        typed = defined_claim(tuple(defined(one, self.region) for one in self.typed.dynamics), self.region, "the typed dynamics")
        own = [typed, self.inverse_claim(), self.diffeomorphism()]
        if self.typed.domain:
            own.append(domain_invariant(_typed_plant(self.typed)))
        worst = next((claim for status in ("refuted", "undecided") for claim in own[:3] if claim.status == status), None)
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
        status: Status = "proved"
        text, witness = "inverse(map(x)) = x", None
        for name, one in zip(self.states, back, strict=True):
            found = compared(one, Variable(name), self.region)
            if found.status == "proved":
                continue
            text += f": {name} comes back as {one}" if found.point else f": not decided for {name}"
            status, witness = found.status, _witness(found)
            break
        return Claim("coordinates.inverse", "premise", status, text, SOURCE, method="canonical form", witness=witness)

    def diffeomorphism(self) -> Claim:
        """det dT/dx is bounded away from 0 over the typed domain."""
        from cdobs_cli.bounds.definedness import bounded_away

        jacobian = [[simplify(one.derivative(name)) for name in self.states] for one in self.map]
        det = simplify(determinant(jacobian))
        status, least, point = bounded_away(det, self.region)
        text = f"|det dT/dx| = |{det}| > 0 for {self.region.text()}"
        witness = Witness("point", "plant", data={"point": point_text(point)}) if point else None
        margin = fraction_text(least) if least is not None else None
        return Claim(
            "coordinates.diffeomorphism", "premise", status, text, SOURCE, margin=margin, method="branch and bound", witness=witness,
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
            claims.append(_printed_claim(f"printed.phi.{i + 1}", text, found))
        if typed.C is not None and typed.C != self.plant.C:
            text = f"the printed C is the derived one, {self.plant.C.texts()}"
            claims.append(_printed_claim("printed.C", text, Comparison("refuted")))
        return tuple(claims)


def _printed_claim(identifier: str, text: str, found: Comparison) -> Claim:
    return Claim(identifier, "printed", found.status, text, SOURCE, method="canonical form", witness=_witness(found))


def _witness(found: Comparison) -> Witness | None:
    return Witness("point", "plant", data={"point": point_text(found.point)}) if found.point else None


def _values(expressions: Sequence[Expression], names: Sequence[str], at: NDArray[np.float64]) -> NDArray[np.float64]:
    import numpy as np

    from cdobs_cli.exact.compiled import compile_floats

    function = compile_floats(expressions, names, arrays=True)
    with np.errstate(all="ignore"):
        columns = function(*np.moveaxis(np.asarray(at, dtype=float), -1, 0))
    return np.stack([np.broadcast_to(np.asarray(column, dtype=float), at.shape[:-1]) for column in columns], axis=-1)


def derive(typed: TypedDynamics) -> tuple[Plant, Coordinates | None]:
    """The Plant behind typed dynamics, and the way back where its coordinates are not the typed states.

    Raises:
        SpecError: no such coordinates are found, an output is not linear in them, an image has no bound.
    """
    if typed.coordinates is None:
        return _split(typed), None
    n = len(typed.states)
    if n > MAX_TRANSFORMED:
        raise _wrong("coordinates", f"at most {MAX_TRANSFORMED} states can be transformed", str(n))
    try:
        change = _lie(typed) if typed.coordinates == "lie" else typed.coordinates
        return _transformed(typed, change)
    except (ExpressionError, ZeroDivisionError) as error:
        raise _wrong("coordinates", f"the transformed plant has no value: {error}") from None


def _wrong(name: str, what: str, got: str | None = None, hint: str | None = None) -> SpecError:
    return SpecError((Problem(("plant", name), what, got, hint=hint),))


def _lie(typed: TypedDynamics) -> CoordinateMap:
    """z = (h, L_f h, .., L_f^(n-1) h) along the drift f(x, 0), and its inverse by elimination."""
    if len(typed.output) != 1:
        raise _wrong("coordinates", "lie takes one output", str(len(typed.output)), "type `map` and `inverse`")
    still: dict[str, Expression] = {source.name: ZERO for source in typed.inputs}
    drift = [simplify(one.substitute(still)) for one in typed.dynamics]
    z = [simplify(typed.output[0])]
    for _ in typed.states[1:]:
        z.append(lie_derivative(z[-1], typed.states, drift))
    nonnegative = {
        name for name, ends in typed.domain.box.items() if ends.lower is not None and ends.lower.sign() in (0, 1)
    }  # fmt: skip
    inverse = solve([Variable(name) - one for name, one in zip(typed.names, z, strict=True)], typed.states, nonnegative)
    if inverse is None:
        shown = ", ".join(str(one) for one in z)
        raise _wrong("coordinates", "the Lie derivatives could not be solved for the states", shown, "type `map` and `inverse`")
    return CoordinateMap(typed.names, tuple(z), tuple(inverse[name] for name in typed.states))


def lie_derivative(h: Expression, states: Sequence[str], f: Sequence[Expression]) -> Expression:
    """L_f h = sum_j dh/dx_j f_j, cancelled."""
    total: Expression = ZERO
    for name, part in zip(states, f, strict=True):
        total = total + h.derivative(name) * part
    return simplify(total)


def _transformed(typed: TypedDynamics, change: CoordinateMap) -> tuple[Plant, Coordinates]:
    n = len(typed.states)
    back = dict(zip(typed.states, change.inverse, strict=True))
    derived = tuple(simplify(lie_derivative(one, typed.states, typed.dynamics).substitute(back)) for one in change.map)
    A = typed.A if typed.A is not None else _chain(n) if typed.coordinates == "lie" else ExactMatrix([[0] * n] * n)
    phi = tuple(simplify(one - linear) for one, linear in zip(derived, _linear(A, typed, change.names), strict=True))
    if typed.coordinates != "lie" and typed.A is None:
        A, phi = _linear_part(phi, change.names)
    C = _linear_output(substituted(typed.output, back), change.names)
    phi = _as_printed(phi, typed.phi)
    region = _typed_region(typed)
    domain = _image_domain(change, region) if typed.domain else Domain()
    plant = Plant(
        change.names, typed.inputs, A, phi, typed.B, C, typed.slopes or _automatic(phi, change.names), typed.sampling,
        domain, _image_of_disturbance(typed, change, region), typed.noise,
    )  # fmt: skip
    return plant, Coordinates(typed, change.names, change.map, change.inverse, derived, plant)


def _chain(n: int) -> ExactMatrix:
    return ExactMatrix([[int(j == i + 1) for j in range(n)] for i in range(n)])


def _linear(A: ExactMatrix, typed: TypedDynamics, names: Sequence[str]) -> list[Expression]:
    """A z + B u."""
    rows = []
    for i in range(len(names)):
        total: Expression = ZERO
        for j, name in enumerate(names):
            total = total + A[i, j].expression * Variable(name)
        for j, source in enumerate(typed.inputs if typed.B is not None else ()):
            assert typed.B is not None
            total = total + typed.B[i, j].expression * Variable(source.name)
        rows.append(total)
    return rows


def _as_printed(phi: Sequence[Expression], printed: Sequence[Expression] | None) -> tuple[Expression, ...]:
    """Each component as the user printed it, where that is the same function."""
    from cdobs_cli.exact.rational import is_zero

    if printed is None:
        return tuple(phi)
    return tuple(theirs if is_zero(own - theirs) else own for own, theirs in zip(phi, printed, strict=True))


def _automatic(phi: Sequence[Expression], names: Sequence[str]) -> Slopes:
    """`auto` for every slope that is not identically 0."""
    n = len(names)
    zero = ExactMatrix([[0] * n] * n)
    entries = ((i, j) for i in range(n) for j, name in enumerate(names) if simplify(phi[i].derivative(name)) != ZERO)
    return Slopes(zero, zero, frozenset(entries))


def _split(typed: TypedDynamics) -> Plant:
    """xdot = f(x, u) as A x + phi + B u in the typed states: linear terms with constant coefficients go to A.

    Raises: SpecError: an output that is not linear; a printed plant that is not this one.
    """
    n = len(typed.states)
    C = _linear_output(tuple(simplify(one) for one in typed.output), typed.states)
    if typed.C is not None and typed.C != C:
        raise SpecError((Problem(("measurement", "C"), "is not that of `output`", str(typed.C.texts()), str(C.texts())),))
    if typed.A is None:
        A, phi = _linear_part(typed.dynamics, typed.states, cancel=False)
        if typed.B is not None:
            inputs = _linear(ExactMatrix([[0] * n] * n), typed, typed.states)
            phi = tuple(simplify(one - part) for one, part in zip(phi, inputs, strict=True))
    else:
        A = typed.A
        phi = tuple(simplify(f - part) for f, part in zip(typed.dynamics, _linear(A, typed, typed.states), strict=True))
    region = _typed_region(typed)
    for i, printed in enumerate(typed.phi or ()):
        found = compared(printed, phi[i], region)
        if found.status == "refuted":
            raise SpecError((Problem(("plant", "phi", i), "is not what `dynamics` leaves beside A x + B u", str(printed), str(phi[i])),))
    return Plant(
        typed.states, typed.inputs, A, _as_printed(phi, typed.phi), typed.B, C, typed.slopes or _automatic(phi, typed.states),
        typed.sampling, typed.domain, typed.disturbance, typed.noise,
    )  # fmt: skip


def _terms(expression: Expression) -> list[Expression]:
    """The terms of a sum."""
    from cdobs_cli.exact.expression import MINUS_ONE, Call

    if isinstance(expression, Call) and expression.function == "add":
        return [term for child in expression.children for term in _terms(child)]
    if isinstance(expression, Call) and expression.function == "multiply" and expression.children[0] == MINUS_ONE:
        return [-term for term in _terms(expression.children[1])]
    return [expression]


def _linear_part(f: Sequence[Expression], names: Sequence[str], *, cancel: bool = True) -> tuple[ExactMatrix, tuple[Expression, ...]]:
    """A and the rest: f = A x + phi, where A takes the terms `constant * state` of each sum as it is typed."""
    rows, rest = [], []
    for one in f:
        row: list[Expression] = [ZERO] * len(names)
        left: Expression = ZERO
        for term in _terms(simplify(one) if cancel else one):
            slopes = [simplify(term.derivative(name)) for name in names]
            linear = _is_plain(term) and not any(slope.variables for slope in slopes)
            if linear and simplify(term.substitute(dict.fromkeys(names, ZERO))) == ZERO:
                row = [simplify(entry + slope) for entry, slope in zip(row, slopes, strict=True)]
            else:
                left = left + term
        rows.append([Exact(entry) for entry in row])
        rest.append(left)
    return ExactMatrix(rows), tuple(rest)


def _is_plain(term: Expression) -> bool:
    """A product of constants and variables: nothing that could be undefined somewhere."""
    from cdobs_cli.exact.expression import Call

    for node in term.walk():
        if node.variables and isinstance(node, Call):
            if node.function not in ("multiply", "add", "divide"):
                return False
            if node.function == "divide" and node.children[1].variables:
                return False
    return True


def _linear_output(outputs: Sequence[Expression], names: Sequence[str]) -> ExactMatrix:
    rows = []
    for k, one in enumerate(outputs):
        slopes = [simplify(one.derivative(name)) for name in names]
        offset = simplify(one.substitute(dict.fromkeys(names, ZERO))) if not any(slope.variables for slope in slopes) else None
        if offset != ZERO:
            what = "an output is linear in the states"
            raise SpecError((Problem(("plant", "output", k), what, str(one), hint="use `coordinates` to make it one of them"),))
        rows.append([Exact(slope) for slope in slopes])
    return ExactMatrix(rows)


def _typed_region(typed: TypedDynamics) -> Region:
    ends = dict(typed.domain.box) | {source.name: source.range for source in typed.inputs if source.range is not None}
    return Region.made(ends, typed.states + tuple(source.name for source in typed.inputs), typed.domain.where)


def _typed_plant(typed: TypedDynamics) -> Plant:
    """The typed dynamics as a Plant with A = 0: for claims in the typed states."""
    n = len(typed.states)
    zero = ExactMatrix([[0] * n] * n)
    C = ExactMatrix([[0] * n])
    return Plant(
        typed.states, typed.inputs, zero, typed.dynamics, None, C, Slopes(zero, zero), typed.sampling, typed.domain, typed.disturbance,
    )  # fmt: skip


def _ends(function: Expression, region: Region) -> tuple[Exact | None, Exact | None]:
    """Proved ends of a function over a region."""
    low, high = (least_bound(side, region, COARSE, TRIAL) for side in (-function, function))
    return None if low is None else -Exact(low), None if high is None else Exact(high)


def _image_domain(change: CoordinateMap, region: Region) -> Domain:
    """A box that holds the image, and the sums and differences of two coordinates where they cut it."""
    box: dict[str, Interval] = {}
    for name, one in zip(change.names, change.map, strict=True):
        low, high = _ends(one, region)
        if low is not None or high is not None:
            box[name] = Interval(low, high)
    where: list[Expression] = []
    if len(change.names) <= 3:
        for i, a in enumerate(change.names):
            for j, b in enumerate(change.names[:i]):
                for side in (1, -1):
                    where += _cuts(change, region, box, (a, i), (b, j), side)
    return Domain(box, tuple(where))


def _cuts(
    change: CoordinateMap, region: Region, box: Mapping[str, Interval], a: tuple[str, int], b: tuple[str, int], side: int
) -> list[Expression]:
    """Ends of z_a + side z_b that are tighter than those of the box."""
    first, second = box.get(a[0]), box.get(b[0])
    if first is None or second is None or None in (first.lower, first.upper, second.lower, second.upper):
        return []
    low, high = _ends(simplify(change.map[a[1]] + Number(side) * change.map[b[1]]), region)
    combined = Variable(a[0]) + Variable(b[0]) if side > 0 else Variable(a[0]) - Variable(b[0])
    opposite = -Variable(a[0]) - Variable(b[0]) if side > 0 else Variable(b[0]) - Variable(a[0])
    near, far = (second.lower, second.upper) if side > 0 else (second.upper, second.lower)
    room = 0.02 * (float(first.upper) - float(first.lower) + float(second.upper) - float(second.lower))  # type: ignore[arg-type]
    cuts = []
    if low is not None and float(low) > float(first.lower) + side * float(near) + room:  # type: ignore[arg-type]
        cuts.append(combined - low.expression)
    if high is not None and float(high) < float(first.upper) + side * float(far) - room:  # type: ignore[arg-type]
        cuts.append(opposite + high.expression)
    return cuts


def _image(map: Sequence[Expression], region: Region, path: tuple[str, ...]) -> Box:
    ends = [_ends(one, region) for one in map]
    if any(low is None or high is None or not isfinite(float(low)) or not isfinite(float(high)) for low, high in ends):
        raise SpecError((Problem(path, "its image in the coordinates has no bound", hint="give a domain, or a tighter one"),))
    return Box(tuple(low for low, _ in ends if low is not None), tuple(high for _, high in ends if high is not None))


def _image_of_disturbance(typed: TypedDynamics, change: CoordinateMap, region: Region) -> Box | None:
    """A box that holds (dT/dx) d."""
    if typed.disturbance is None:
        return None
    d = tuple(f"d.{i}" for i in range(len(typed.states)))
    ends = {name: Interval(low, high) for name, low, high in zip(d, typed.disturbance.lower, typed.disturbance.upper, strict=True)}
    held = Region.made({**region.ends, **ends}, (*region.names, *d), region.where)
    pushed = [lie_derivative(one, typed.states, [Variable(name) for name in d]) for one in change.map]
    return _image(pushed, held, ("plant", "disturbance"))
