"""The plant, its measurement, and what is claimed of its slopes: exact entries, floats and balls as views.

xdot = A x + phi(x, u) + B u + d,    y_k = C x(t_k) + v_k,    lower_ij <= d phi_i / d x_j <= upper_ij
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import field, replace
from fractions import Fraction
from functools import cached_property
from itertools import product
from typing import Any, Literal

from cdobs_cli.codec import OPTIONAL
from cdobs_cli.delays import Delay
from cdobs_cli.exact.expression import ZERO, Expression, Variable, call
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_HALF = Exact(Fraction(1, 2))


@dataclass(frozen=True)
class Interval:
    """[lower, upper], each end exact; None is unbounded."""

    lower: Exact | None
    upper: Exact | None

    def __str__(self) -> str:
        """`[0, 1]`, `[-inf, 1]`."""
        low = "-inf" if self.lower is None else str(self.lower)
        return f"[{low}, {'inf' if self.upper is None else self.upper}]"


@dataclass(frozen=True)
class Box:
    """A box of vectors: lower <= . <= upper, componentwise."""

    lower: tuple[Exact, ...]
    upper: tuple[Exact, ...]

    @property
    def sizes(self) -> tuple[Any, ...]:
        """max |.| of each component: a rational of flint where both ends are rational, else a ball."""
        return tuple(
            max(abs(low.scalar), abs(high.scalar))
            if low.rational is not None and high.rational is not None
            else abs(low.ball()).max(abs(high.ball()))
            for low, high in zip(self.lower, self.upper, strict=True)
        )

    @property
    def float_sizes(self) -> tuple[float, ...]:
        ends = zip(self.lower, self.upper, strict=True)
        return tuple(max(abs(float(low)), abs(float(high))) for low, high in ends)

    @property
    def middle(self) -> tuple[Exact, ...]:
        return tuple((low + high) * _HALF for low, high in zip(self.lower, self.upper, strict=True))


@dataclass(frozen=True)
class Input:
    """A known input signal; its range where one is declared."""

    name: str
    range: Interval | None = None


@dataclass(frozen=True)
class Domain:
    """Where the slopes are claimed: a box per state, and affine inequalities `expression >= 0`.

    Empty means all of R^n. The proof takes the convex set that both describe.
    """

    box: dict[str, Interval] = field(default_factory=dict)
    where: tuple[Expression, ...] = ()

    def __bool__(self) -> bool:
        return bool(self.box or self.where)

    def __hash__(self) -> int:
        return hash((frozenset(self.box.items()), self.where))

    @property
    def text(self) -> str:
        """In a sentence's words: `x in [0, 1], 1 - (x + y) >= 0`."""
        parts = [f"{name} in {interval}" for name, interval in self.box.items()]
        return ", ".join((*parts, *(f"{w} >= 0" for w in self.where)))


Entry = tuple[int, int]


@dataclass(frozen=True)
class Quantity:
    """rho(x, u) in [lower, upper], on which entries of the Jacobian of phi depend: V_ij holds weight_ij rho.

    name: `2.1` for an entry that moves by itself, `rho1`, `rho2`, .. for functions that several entries share.
    function: rho where it is known; of an entry by itself its derivative is meant.
    of: `phi`, or `y` where the entry is one of the Jacobian of the outputs.
    """

    name: str
    weights: tuple[tuple[Entry, Exact], ...]
    lower: Exact
    upper: Exact
    function: Expression | None = None
    of: Literal["phi", "y"] = "phi"

    @property
    def entry(self) -> Entry:
        """The first entry that it moves, from 0."""
        return self.weights[0][0]

    @property
    def is_entry(self) -> bool:
        """Whether it is an entry of the Jacobian itself."""
        return self.function is None

    def text(self, states: tuple[str, ...]) -> str:
        """In a sentence: `d phi_y / d x`, or the function itself."""
        i, j = self.entry
        if self.of == "y":
            return f"d y_{i + 1} / d {states[j]}"
        return f"d phi_{states[i]} / d {states[j]}" if self.function is None else str(self.function)

    @property
    def middle(self) -> Exact:
        """The middle of its interval."""
        return (self.lower + self.upper) * _HALF

    @staticmethod
    def of_entry(entry: Entry, lower: Exact, upper: Exact) -> Quantity:
        return Quantity(f"{entry[0] + 1}.{entry[1] + 1}", ((entry, Exact(1)),), lower, upper)


@dataclass(frozen=True)
class Slopes:
    """Claimed bounds of the Jacobian of phi, shapes (n, n), or of the outputs, (p, n); entries in `auto` are to be
    found and proved (their lower and upper are 0 until then).

    joint: functions that several entries share, where they were found; those entries are `offset` plus what the
    functions add, and lower, upper still bound each of them by itself.
    """

    lower: ExactMatrix
    upper: ExactMatrix
    auto: frozenset[Entry] = frozenset()
    joint: tuple[Quantity, ...] = ()
    offset: tuple[tuple[Entry, Exact], ...] = ()

    @cached_property
    def entries(self) -> tuple[tuple[int, int], ...]:
        """Entries that are not the constant 0, row by row."""
        n, m = self.lower.shape
        ends = (self.lower, self.upper)
        places = product(range(n), range(m))
        return tuple(at for at in places if at in self.auto or any(end[at].sign() != 0 for end in ends))

    @cached_property
    def uncertain(self) -> tuple[tuple[int, int], ...]:
        """Entries whose two ends differ: the corners of the class are over these."""
        return tuple((i, j) for i, j in self.entries if (i, j) in self.auto or self.lower[i, j] != self.upper[i, j])

    @cached_property
    def shared(self) -> frozenset[Entry]:
        """Entries that are made of the joint functions."""
        return frozenset((*(entry for entry, _ in self.offset), *(e for rho in self.joint for e, _ in rho.weights)))

    @cached_property
    def quantities(self) -> tuple[Quantity, ...]:
        """What varies: the corners of the class are over these. Entries by themselves, row by row, then joint ones."""
        alone = (entry for entry in self.uncertain if entry not in self.shared)
        return (*(Quantity.of_entry(entry, self.lower[entry], self.upper[entry]) for entry in alone), *self.joint)

    @property
    def apart(self) -> Slopes:
        """The class in which every entry moves by itself: it holds this one."""
        return replace(self, joint=(), offset=())

    def with_bounds(self, bounds: Mapping[str, tuple[str, str]]) -> Slopes:
        """`auto` entries replaced by bounds: {"i.j": (lower, upper)}, from 1. Raises: KeyError where there is none."""
        lower, upper = ([list(row) for row in end.rows] for end in (self.lower, self.upper))
        for i, j in self.auto:
            low, high = bounds[f"{i + 1}.{j + 1}"]
            lower[i][j], upper[i][j] = Exact(low), Exact(high)
        return Slopes(ExactMatrix(lower), ExactMatrix(upper))

    def constant(self, entry: Entry) -> Exact:
        """What an entry is without the quantities that vary."""
        if entry in self.shared:
            return dict(self.offset).get(entry, EXACT_ZERO)
        return EXACT_ZERO if entry in self.uncertain else self.lower[entry]


@dataclass(frozen=True)
class Plant:
    """The plant as typed. Shapes: A (n, n), B (n, m) or None, C (p, n), phi n expressions of states and
    inputs (parameters substituted).

    h: what is measured, p expressions of states and inputs; None where it is C x. H: the bounds of its Jacobian,
    (p, n); None where that is C. C holds the entries of the Jacobian that are constant, and the middle of those that
    vary. disturbance, noise: boxes that hold d(t) and v_k. intensity: of a white d, (n, n), per time unit; covariance:
    of a white v_k, (p, p). delays: how late the measurements of each sensor arrive; empty where all are there at once.
    """

    states: tuple[str, ...]
    inputs: tuple[Input, ...]
    A: ExactMatrix
    phi: tuple[Expression, ...]
    B: ExactMatrix | None
    C: ExactMatrix
    slopes: Slopes
    sampling: SamplingLaw
    domain: Domain = field(default_factory=Domain)
    disturbance: Box | None = None
    noise: Box | None = None
    intensity: ExactMatrix | None = None
    covariance: ExactMatrix | None = None
    h: tuple[Expression, ...] | None = None
    H: Slopes | None = None
    delays: tuple[Delay, ...] = field(default=(), metadata={OPTIONAL: True})

    @property
    def n(self) -> int:
        """Number of states."""
        return len(self.states)

    @property
    def p(self) -> int:
        """Number of outputs."""
        return self.C.shape[0]

    @property
    def gain_shape(self) -> tuple[int, int]:
        """Of a gain that corrects each state at samples: (n, p), or the gains of all samples of a hyperperiod side by
        side."""
        return self.n, self.sampling.gain_columns(self.p)

    @property
    def is_disturbed(self) -> bool:
        """Whether a disturbance is declared, bounded or white."""
        return self.disturbance is not None or self.intensity is not None

    @property
    def is_noisy(self) -> bool:
        """Whether measurement noise is declared, bounded or of a covariance."""
        return self.noise is not None or self.covariance is not None

    @property
    def is_perturbed(self) -> bool:
        """Whether anything is declared that acts on the error: a disturbance or noise of any kind."""
        return self.is_disturbed or self.is_noisy

    @property
    def has_bounded(self) -> bool:
        """Whether disturbance or noise is a bounded signal; the other one may be white."""
        return self.disturbance is not None or self.noise is not None

    @property
    def has_white(self) -> bool:
        """Whether disturbance or noise is white; the other one may be bounded."""
        return self.intensity is not None or self.covariance is not None

    @property
    def has_only_bounded(self) -> bool:
        """Whether something is declared that acts on the error, and all of it is bounded."""
        return self.has_bounded and not self.has_white

    @property
    def has_only_white(self) -> bool:
        """Whether something is declared that acts on the error, and all of it is white."""
        return self.has_white and not self.has_bounded

    @property
    def functions(self) -> tuple[Expression, ...]:
        """What must have a value all over the domain: phi, and h where it is known."""
        return (*self.phi, *(self.h or ()))

    @property
    def output_quantities(self) -> tuple[Quantity, ...]:
        """The slopes of the outputs that vary, row by row."""
        return () if self.H is None else tuple(replace(rho, of="y") for rho in self.H.quantities)

    def output_matrix(self, w: tuple[Exact, ...]) -> ExactMatrix:
        """The outputs' Jacobian at values w of the slopes that vary, shape (p, n)."""
        rows = [list(row) for row in self.C.rows]
        for value, rho in zip(w, self.output_quantities, strict=True):
            k, j = rho.entry
            rows[k][j] = value
        return ExactMatrix(rows) if w else self.C

    @property
    def is_to_be_found(self) -> bool:
        """Whether there are slopes, of phi or of the outputs, whose bounds are to be found."""
        return bool(self.slopes.auto or (self.H is not None and self.H.auto))

    @property
    def is_canonical(self) -> bool:
        """A a chain of integrators, C = [1 0 .. 0], slopes only in the last row (Dinh2014, Theorem III.2)."""
        n = self.n
        chain = all(self.A[i, j] == Exact(1 if j == i + 1 else 0) for i in range(n) for j in range(n))
        first = self.p == 1 and all(self.C[0, j] == Exact(1 if j == 0 else 0) for j in range(n))
        last = all(i == n - 1 for i, _ in self.slopes.entries)
        return chain and first and last and not self.output_quantities

    @property
    def is_feedforward(self) -> bool:
        """A and every slope upper triangular (Dinh2014, Assumption 2)."""
        n = self.n
        upper = all(self.A[i, j].sign() == 0 for i in range(n) for j in range(i))
        return upper and all(j >= i for i, j in self.slopes.entries)

    def with_slopes(self, bounds: Mapping[str, tuple[str, str]]) -> Plant:
        """The plant with slopes declared `auto` replaced by bounds: {"i.j": (lower, upper)}, from 1.

        Raises: KeyError where an `auto` entry has no bound.
        """
        return replace(self, slopes=self.slopes.with_bounds(bounds)) if self.slopes.auto else self

    def with_output_slopes(self, bounds: Mapping[str, tuple[str, str]]) -> Plant:
        """The plant with the slopes of its outputs replaced likewise: {"k.j": (lower, upper)}, from 1.

        Raises: KeyError where an `auto` entry has no bound.
        """
        if self.H is None or not self.H.auto:
            return self
        H = self.H.with_bounds(bounds)
        C = [list(row) for row in self.C.rows]
        for k, j in self.H.auto:
            C[k][j] = (H.lower[k, j] + H.upper[k, j]) * _HALF
        return replace(self, C=ExactMatrix(C), H=H)

    def widened(self, margin: Mapping[str, Fraction | Exact]) -> Plant:
        """The plant with every side of its domain moved outwards so far that each named state has `margin` of room:
        ends of the box by the margin, a limit w >= 0 to w + sum_j |dw/dx_j| margin_j >= 0."""
        from cdobs_cli.exact.rational import simplify

        box = {}
        for name, interval in self.domain.box.items():
            by = _exact(margin.get(name, 0))
            lower, upper = interval.lower, interval.upper
            box[name] = Interval(None if lower is None else lower - by, None if upper is None else upper + by)
        where = []
        for w in self.domain.where:
            room = EXACT_ZERO
            for name, size in margin.items():
                slope = Exact(simplify(w.derivative(name)))
                room = room + (slope if slope.sign() == 1 else -slope) * _exact(size)
            where.append(w + room.expression)
        return replace(self, domain=Domain(box, tuple(where)))

    @property
    def on_box(self) -> Plant:
        """The plant on the whole box of its domain, without the affine limits."""
        return replace(self, domain=Domain(self.domain.box))

    def clipped(self, prefix: str = "") -> dict[str, Expression]:
        """Each state, by its name, cut to the domain's box, over the names `prefix + state`."""
        values: dict[str, Expression] = {}
        for name in self.states:
            interval = self.domain.box.get(name, Interval(None, None))
            value: Expression = Variable(prefix + name)
            if interval.lower is not None and interval.upper is not None:
                value = call("sat", value, interval.lower.expression, interval.upper.expression)
            elif interval.lower is not None:
                value = call("max", value, interval.lower.expression)
            elif interval.upper is not None:
                value = call("min", value, interval.upper.expression)
            values[name] = value
        return values

    def continued(self) -> Plant:
        """The plant with phi, and outputs whose slopes vary, continued linearly outside the domain's box:
        phi(sat(x)) + G (x - sat(x)).

        sat cuts each state to the box, G is the centre of the slope box. For x in the box and any x_hat
        sat(x_hat)_j - x_j = theta_j (x_hat_j - x_j) with theta_j in [0, 1], so column j of the error's slope is
        theta_j V_j + (1 - theta_j) G_j: it stays in the slope box, wherever the estimate goes.
        """
        inside = self.clipped()

        def beyond(one: Expression, G: Iterable[Exact]) -> Expression:
            value = one.substitute(inside)
            for name, slope in zip(self.states, G, strict=True):
                if name in self.domain.box and slope.sign() != 0:
                    value = value + slope.expression * (Variable(name) - inside[name])
            return value

        ends = zip(self.slopes.lower.rows, self.slopes.upper.rows, strict=True)
        centres = [[(low + high) * _HALF for low, high in zip(*rows, strict=True)] for rows in ends]
        phi = tuple(beyond(one, G) for one, G in zip(self.phi, centres, strict=True))
        varying = {rho.entry[0] for rho in self.output_quantities}
        h = self.h and tuple(beyond(one, self.C.rows[k]) if k in varying else one for k, one in enumerate(self.h))
        return replace(self, phi=phi, h=h)

    def without_zero_slopes(self) -> Plant:
        """The plant with `auto` only where phi depends on the state: elsewhere the slope is the constant 0."""
        kept = frozenset((i, j) for i, j in self.slopes.auto if self.phi[i].derivative(self.states[j]) != ZERO)
        return replace(self, slopes=replace(self.slopes, auto=kept))

    def right_hand_side(self, prefix: str = "", *, disturbed: bool = False) -> tuple[Expression, ...]:
        """A x + phi(x, u) + B u (+ d) as expressions over the names `prefix + state`, the inputs, and
        `d.0`, `d.1`, .. when `disturbed`."""
        x = {name: Variable(prefix + name) for name in self.states}
        rows = [row.substitute(x) if prefix else row for row in self.phi]
        rows = [sum(weighted(self.A, i, x.values()), row) for i, row in enumerate(rows)]
        if self.B is not None:
            inputs = [Variable(source.name) for source in self.inputs]
            rows = [sum(weighted(self.B, i, inputs), row) for i, row in enumerate(rows)]
        if disturbed and self.is_disturbed:
            rows = [row + Variable(f"d.{i}") for i, row in enumerate(rows)]
        return tuple(rows)

    def outputs(self, prefix: str = "") -> tuple[Expression, ...]:
        """C x, or h(x, u), as expressions over the names `prefix + state` and the inputs."""
        x = [Variable(prefix + name) for name in self.states]
        if self.h is not None:
            return tuple(one.substitute(dict(zip(self.states, x, strict=True))) for one in self.h)
        return tuple(sum(weighted(self.C, k, x), ZERO) for k in range(self.p))


def weighted(matrix: ExactMatrix, i: int, factors: Iterable[Expression]) -> Iterator[Expression]:
    """The terms of row i of a matrix times a vector of expressions."""
    return (matrix[i, j].expression * factor for j, factor in enumerate(factors))


def _exact(value: Fraction | Exact | int) -> Exact:
    return value if isinstance(value, Exact) else Exact(value)


@dataclass(frozen=True)
class CoordinateMap:
    """A typed change of coordinates z = map(x), x = inverse(z): `map` over the states, `inverse` over `names`."""

    names: tuple[str, ...]
    map: tuple[Expression, ...]
    inverse: tuple[Expression, ...]


@dataclass(frozen=True)
class TypedDynamics:
    """A plant typed as xdot = f(x, u) + d, y = h(x) + v in the user's own states, before it is a Plant
    (`cdobs_cli.coordinates.derive` makes one of it).

    `coordinates`: a typed map, `lie` for z = (h, L_f h, .., L_f^(n-1) h), None where the states stay. `names`:
    of the coordinates that the Plant is in (the states themselves where `coordinates` is None); the printed
    `A`, `phi`, `B`, `C`, `slopes` are over them and None where nothing is printed. `domain` and `disturbance`
    are in the user's states.
    """

    states: tuple[str, ...]
    inputs: tuple[Input, ...]
    dynamics: tuple[Expression, ...]
    output: tuple[Expression, ...]
    sampling: SamplingLaw
    coordinates: CoordinateMap | Literal["lie"] | None = None
    names: tuple[str, ...] = ()
    A: ExactMatrix | None = None
    phi: tuple[Expression, ...] | None = None
    B: ExactMatrix | None = None
    C: ExactMatrix | None = None
    slopes: Slopes | None = None
    domain: Domain = field(default_factory=Domain)
    disturbance: Box | None = None
    noise: Box | None = None
    intensity: ExactMatrix | None = None
    covariance: ExactMatrix | None = None
    delays: tuple[Delay, ...] = field(default=(), metadata={OPTIONAL: True})


def coordinate_names(n: int, taken: frozenset[str]) -> tuple[str, ...]:
    """Names for transformed coordinates that nobody typed: x1 .. xn, or z, xi, eta where those are taken."""
    for letter in ("x", "z", "xi", "eta"):
        names = tuple(f"{letter}{i + 1}" for i in range(n))
        if not taken & set(names):
            return names
    return tuple(f"{'_'.join(sorted(taken))}_{i + 1}" for i in range(n))
