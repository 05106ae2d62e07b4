"""Two hybrid systems: the error inclusion that proofs read, and the equations that simulations run."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import field, replace
from itertools import product
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from cdobs_cli.exact.expression import Expression, Variable
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.plant import Domain, Entry, Plant, Quantity
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from cdobs_cli.exact.matrix import Matrix

M = TypeVar("M")


@dataclass(frozen=True)
class ErrorMaps(Generic[M]):
    """The matrices of an inclusion in one arithmetic (numpy arrays, or exact Matrix objects).

    edot = (base + sum_k v_k parts[k]) e with v_k in [lower[k], upper[k]];
    e+ = (jump + sum_m (w_m - middle of its interval) jump_parts[m]) e with w_m in [jump_lower[m], jump_upper[m]],
    the slopes of the outputs that vary, free at every sample. Shapes: (N, N).
    """

    base: M
    parts: tuple[M, ...]
    lower: tuple[Any, ...]
    upper: tuple[Any, ...]
    jump: M
    jump_parts: tuple[M, ...] = ()
    jump_lower: tuple[Any, ...] = ()
    jump_upper: tuple[Any, ...] = ()

    def flow(self, v: tuple[Any, ...]) -> M:
        """The flow matrix at slope values v."""
        total: Any = self.base
        for value, part in zip(v, self.parts, strict=True):
            total = total + part * value
        return total  # type: ignore[no-any-return]

    def corners(self) -> Iterator[M]:
        """Flow matrices at the 2^(number of quantities that vary) corners."""
        for v in product(*zip(self.lower, self.upper, strict=True)):
            yield self.flow(v)

    def jump_at(self, w: tuple[Any, ...]) -> M:
        """The jump at slopes w of the outputs."""
        total: Any = self.jump
        for value, part, low, high in zip(w, self.jump_parts, self.jump_lower, self.jump_upper, strict=True):
            total = total + part * (value - (low + high) / 2)
        return total  # type: ignore[no-any-return]

    def jumps(self) -> Iterator[M]:
        """Jumps at the 2^(number of slopes of the outputs that vary) corners: one where none does."""
        for w in product(*zip(self.jump_lower, self.jump_upper, strict=True)):
            yield self.jump_at(w)

    def mapped(self, of_flow: Callable[[M], M], of_jump: Callable[[M], M]) -> ErrorMaps[M]:
        """The same with a linear map of every flow matrix, and one of every jump."""
        parts, jump_parts = tuple(map(of_flow, self.parts)), tuple(map(of_jump, self.jump_parts))
        return replace(
            self, base=of_flow(self.base), parts=parts, jump=of_jump(self.jump), jump_parts=jump_parts
        )  # fmt: skip


@dataclass(frozen=True)
class NoiseMaps(Generic[M]):
    """How disturbance and noise enter an error: edot = .. + drive d(t), e+ = .. + kick v_k at the sample of v_k.

    Shapes: drive (N, n), kick (N, p).
    """

    drive: M
    kick: M


@dataclass(frozen=True)
class HybridInclusion:
    """The error system of one plant with one gain.

    Flow between samples: edot in Co{corners} e; jump e+ in Co{jumps} e when the clock (time since the last sample)
    is in [T_min, T_max] of `sampling`. A family makes it (`Family.inclusion`); certificates, falsifiers and
    tests read it. `quantities` are what varies, in the order of the values v.

    Args:
        assemble: called with a view of the plant and gain (numpy arrays, or exact Matrix objects) returns
            ErrorMaps in that arithmetic, so the error equation is written once.
        assemble_noise: the same of what disturbance and noise do; None where nobody asks.
    """

    assemble: Callable[[PlantView[Any]], ErrorMaps[Any]]
    plant: Plant
    gain: Mapping[str, Any]
    sampling: SamplingLaw
    quantities: tuple[Quantity, ...]
    assemble_noise: Callable[[PlantView[Any]], NoiseMaps[Any]] | None = None

    @property
    def entries(self) -> tuple[Entry, ...]:
        """The first slope entry (i, j) behind each value."""
        return tuple(rho.entry for rho in self.quantities)

    @property
    def outputs(self) -> tuple[Quantity, ...]:
        """The slopes of the outputs that vary, in the order of the values w."""
        return self.plant.output_quantities

    @property
    def view_floats(self) -> PlantView[NDArray[np.float64]]:
        """Plant and gain in floats. Where each sample has a gain of its own no one is the gain: it is not a number."""
        if not self.sampling.has_sensors:
            return PlantView.floats(self.plant, self.gain)
        import numpy as np

        view = PlantView.floats(self.plant, {})
        return replace(view, gain={name: np.full(view.C.T.shape, np.nan) for name in self.gain})

    @property
    def view_balls(self) -> PlantView[Matrix]:
        """Plant and gain, rational where the data are rational, balls at the working precision otherwise; the gain as
        in `view_floats`."""
        if not self.sampling.has_sensors:
            return PlantView.balls(self.plant, self.gain)
        from flint import arb

        from cdobs_cli.exact.matrix import Matrix

        view = PlantView.balls(self.plant, {})
        unknown = Matrix.from_rows([[arb("nan")] * self.plant.p] * self.plant.n)
        return replace(view, gain=dict.fromkeys(self.gain, unknown))

    @property
    def floats(self) -> ErrorMaps[NDArray[np.float64]]:
        return self.assemble(self.view_floats)

    @property
    def balls(self) -> ErrorMaps[Matrix]:
        """The maps in the arithmetic of `view_balls`."""
        return self.assemble(self.view_balls)

    @property
    def phases_floats(self) -> list[ErrorMaps[NDArray[np.float64]]]:
        """The maps of each reading: all of one flow, each with its own jump; one where every sample is as the others.
        Raises: ValueError for a gain that does not fit the law."""
        if not self.sampling.has_sensors:
            return [self.floats]
        view = PlantView.floats(self.plant, {})
        return [
            self.assemble(replace(view, gain={name: K.floats for name, K in own.items()})) for own in self.phase_gains
        ]

    @property
    def phases_balls(self) -> list[ErrorMaps[Matrix]]:
        """The same in the arithmetic of `view_balls`."""
        if not self.sampling.has_sensors:
            return [self.balls]
        view = PlantView.balls(self.plant, {})
        return [
            self.assemble(replace(view, gain={name: K.balls() for name, K in own.items()})) for own in self.phase_gains
        ]

    @property
    def phases_noise_floats(self) -> list[NoiseMaps[NDArray[np.float64]]]:
        """How disturbance, and the noise of each reading, enter the error. Raises: as
        `noise_floats`."""
        view = PlantView.floats(self.plant, {})
        gains = ({name: K.floats for name, K in own.items()} for own in self.phase_gains)
        return [self._noise(replace(view, gain=own)) for own in gains]

    @property
    def phases_noise_balls(self) -> list[NoiseMaps[Matrix]]:
        """The same in the arithmetic of `view_balls`."""
        view = PlantView.balls(self.plant, {})
        gains = ({name: K.balls() for name, K in own.items()} for own in self.phase_gains)
        return [self._noise(replace(view, gain=own)) for own in gains]

    @property
    def phase_gains(self) -> list[dict[str, ExactMatrix]]:
        """The gain of each reading, shape (n, p), 0 where an output is not read then."""
        own = {name: self.sampling.split(K, self.plant.p) for name, K in self.gain.items()}
        return [{name: own[name][q] for name in own} for q in range(len(self.sampling.readings))]

    @property
    def noise_floats(self) -> NoiseMaps[NDArray[np.float64]]:
        """Raises: NotImplementedError where the family does not say how noise enters its error."""
        return self._noise(self.view_floats)

    @property
    def noise_balls(self) -> NoiseMaps[Matrix]:
        """In the arithmetic of `view_balls`. Raises: NotImplementedError as `noise_floats`."""
        return self._noise(self.view_balls)

    def _noise(self, view: PlantView[Any]) -> NoiseMaps[Any]:
        if self.assemble_noise is None:
            raise NotImplementedError("noise in this error system")
        return self.assemble_noise(view)


@dataclass(frozen=True)
class PlantView(Generic[M]):
    """A, C, the slope class and the gain in one arithmetic: slopes are sum_k v_k parts[k] with v_k in [lower[k],
    upper[k]],
    and A holds what is constant of them too. Outputs whose slopes vary: C is at their middle, `outputs` holds a matrix
    for each of them, and their ends. Shapes: A, parts, identity (n, n); C, outputs (p, n); output_identity (p, p)."""

    A: M
    C: M
    gain: Mapping[str, M]
    parts: tuple[M, ...]
    lower: tuple[Any, ...]
    upper: tuple[Any, ...]
    quantities: tuple[Quantity, ...]
    identity: M
    output_identity: M
    outputs: tuple[M, ...] = ()
    output_lower: tuple[Any, ...] = ()
    output_upper: tuple[Any, ...] = ()

    def unit(self, i: int) -> M:
        """Column i of the identity, shape (n, 1)."""
        return self.identity[:, [i]]  # type: ignore[index, no-any-return]

    def flow(self, v: Iterable[Any]) -> M:
        """A + V at the values v of the quantities."""
        total: Any = self.A
        for value, part in zip(v, self.parts, strict=True):
            total = total + part * value
        return total  # type: ignore[no-any-return]

    def output_corners(self) -> list[M]:
        """C at the 2^(number of slopes of the outputs that vary) corners."""
        corners = []
        for w in product(*zip(self.output_lower, self.output_upper, strict=True)):
            C: Any = self.C
            for value, part, low, high in zip(w, self.outputs, self.output_lower, self.output_upper, strict=True):
                C = C + part * (value - (low + high) / 2)
            corners.append(C)
        return corners

    @property
    def vertices(self) -> list[M]:
        """A + V at the 2^(number of quantities that vary) corners."""
        return [self.flow(v) for v in product(*zip(self.lower, self.upper, strict=True))]

    @staticmethod
    def floats(plant: Plant, gain: Mapping[str, Any]) -> PlantView[NDArray[np.float64]]:
        import numpy as np

        quantities, outputs = plant.slopes.quantities, plant.output_quantities
        return PlantView(
            A=plant.A.floats + np.array(_constant_slopes(plant, float)),
            C=np.array(plant.C.floats),
            gain={name: np.array(matrix.floats) for name, matrix in gain.items()},
            parts=tuple(np.array(_weights((plant.n, plant.n), rho, float)) for rho in quantities),
            lower=tuple(float(rho.lower) for rho in quantities),
            upper=tuple(float(rho.upper) for rho in quantities),
            quantities=quantities,
            identity=np.eye(plant.n),
            output_identity=np.eye(plant.p),
            outputs=tuple(np.array(_weights(plant.C.shape, rho, float)) for rho in outputs),
            output_lower=tuple(float(rho.lower) for rho in outputs),
            output_upper=tuple(float(rho.upper) for rho in outputs),
        )

    @staticmethod
    def balls(plant: Plant, gain: Mapping[str, Any]) -> PlantView[Matrix]:
        from cdobs_cli.exact.matrix import Matrix

        quantities, outputs = plant.slopes.quantities, plant.output_quantities
        return PlantView(
            A=plant.A.balls() + Matrix.from_rows(_constant_slopes(plant, _scalar)),
            C=plant.C.balls(),
            gain={name: matrix.balls() for name, matrix in gain.items()},
            parts=tuple(Matrix.from_rows(_weights((plant.n, plant.n), rho, _scalar)) for rho in quantities),
            lower=tuple(rho.lower.scalar for rho in quantities),
            upper=tuple(rho.upper.scalar for rho in quantities),
            quantities=quantities,
            identity=Matrix.identity(plant.n),
            output_identity=Matrix.identity(plant.p),
            outputs=tuple(Matrix.from_rows(_weights(plant.C.shape, rho, _scalar)) for rho in outputs),
            output_lower=tuple(rho.lower.scalar for rho in outputs),
            output_upper=tuple(rho.upper.scalar for rho in outputs),
        )


def corrected_copy(view: PlantView[Any]) -> ErrorMaps[Any]:
    """edot = (A + V) e with V in the slope class, e+ = (I - K C) e, for e = x_hat - x and a copy of the model
    corrected by K (y - C x_hat) at samples; e+ = (I - K H) e, H in the slopes of h, where it is K (y - h(x_hat, u)).

    Source: Dinh2014, (8), (10); Andrieu2014, (10)
    """
    K: Any = view.gain["K"]
    return ErrorMaps(
        view.A, view.parts, view.lower, view.upper, view.identity - K @ view.C,
        tuple(-(K @ H) for H in view.outputs), view.output_lower, view.output_upper,
    )  # fmt: skip


def corrected_copy_noise(view: PlantView[Any]) -> NoiseMaps[Any]:
    """edot = .. - d, e+ = .. + K v: noise in the error of `corrected_copy`, for y_k = C x(t_k) + v_k."""
    return NoiseMaps(-view.identity, view.gain["K"])


def _scalar(number: Exact) -> Any:
    return number.scalar


def _constant_slopes(plant: Plant, value: Callable[[Exact], Any]) -> list[list[Any]]:
    return [[value(plant.slopes.constant((i, j))) for j in range(plant.n)] for i in range(plant.n)]


def _weights(shape: tuple[int, int], rho: Quantity, value: Callable[[Exact], Any]) -> list[list[Any]]:
    weights, (rows, columns) = dict(rho.weights), shape
    return [[value(weights[i, j]) if (i, j) in weights else 0 for j in range(columns)] for i in range(rows)]


@dataclass(frozen=True)
class Observer:
    """An observer as equations; simulation compiles them, export prints them.

    Names in the expressions: the observer's own `states`; the plant's inputs; `t`; in `jump` also the
    measurement `y.0`, `y.1`, .. and `elapsed`, the time since the previous sample; in `trigger` also
    `elapsed`; in `start` the names `initial.<state>` (the initial estimate), `lower.<state>`,
    `upper.<state>` (the known box of x(0)) and `y.0`, ...

    Attributes:
        states: names of the observer's states, e.g. `hat.theta` (a dot keeps them apart from user names).
        start: value of each state at t_0, before the first measurement is used.
        flow: time derivative of each state between samples.
        jump: value of each state just after a sample.
        jumps: where samples differ in what is read, the jump of each reading of the sampling law; `jump` is the first
            of them then.
        jump_at_start: whether the sample at t_0 makes a jump.
        trigger: the next sample is when this expression first reaches 0 from below; None: the sampling law decides.
        estimates: what is reported, by name: {"x_hat": n expressions} or {"x_lower": .., "x_upper": ..}.
        control: inputs held from one sample to the next: name -> expression evaluated right after the jump.
        internals: further outputs worth a figure, by name, e.g. {"L": ..}.
        compares: of sensors that send on change |y - C x_hat| / delta - 1 of each, over its states and `y.0`, ..: it
            sends when that reaches 0, and `jumps` are those of the sensors. compared_always: whether they compare all
            the time; else at the instants of the sampling law.
        stops: conditions `expression <= 0` under which a run ends with a finding: (expression, sentence).
    """

    states: tuple[str, ...]
    start: tuple[Expression, ...]
    flow: tuple[Expression, ...]
    jump: tuple[Expression, ...]
    estimates: Mapping[str, tuple[Expression, ...]]
    jump_at_start: bool = True
    trigger: Expression | None = None
    control: Mapping[str, Expression] = field(default_factory=dict)
    internals: Mapping[str, Expression] = field(default_factory=dict)
    stops: tuple[tuple[Expression, str], ...] = ()
    jumps: tuple[tuple[Expression, ...], ...] = ()
    compares: tuple[Expression, ...] = ()
    compared_always: bool = True


@dataclass(frozen=True)
class OriginalStates:
    """The states that the user typed where the plant is in other coordinates: their domain, and each of them, by its
    name, over the plant's states."""

    domain: Domain
    inverse: Mapping[str, Expression]


@dataclass(frozen=True)
class HybridSystem:
    """Plant and observer together: flow, jump, next sample, as expressions over one list of states.

    estimate_must_stay: whether an estimate outside the plant's domain counts as leaving it, as a state does.
    original: the user's states, where the plant is not in them.

    Names: `states` (the plant's, then the observer's), `signals` (inputs, `d.i`), `t`; in `jump` and
    `measurement` also `v.i`, `y.i`, `elapsed`.
    """

    plant: Plant
    observer: Observer
    estimate_must_stay: bool = True
    original: OriginalStates | None = None

    @property
    def states(self) -> tuple[str, ...]:
        return self.plant.states + self.observer.states

    @property
    def flow(self) -> tuple[Expression, ...]:
        """Time derivatives of all states."""
        return self.plant.right_hand_side(disturbed=True) + self.observer.flow

    @property
    def measurement(self) -> tuple[Expression, ...]:
        """y_k = C x or h(x, u) (+ v): over states, inputs and `v.0`, `v.1`, .."""
        rows = self.plant.outputs()
        if not self.plant.is_noisy:
            return rows
        return tuple(row + Variable(f"v.{k}") for k, row in enumerate(rows))

    @property
    def compares(self) -> tuple[Expression, ...]:
        """What sensors that send on change compare, over states, inputs and `v.0`, .."""
        measured = {f"y.{k}": row for k, row in enumerate(self.measurement)}
        return tuple(row.substitute(measured) for row in self.observer.compares)

    @property
    def jumps(self) -> tuple[tuple[Expression, ...], ...]:
        """All states after a sample, over states, `y.0`, .. and `elapsed`: the plant's do not jump. Of each reading of
        the sampling law its own, where the observer has one for all of them the same."""
        kept = tuple(Variable(name) for name in self.plant.states)
        alike = (self.observer.jump,) * max(1, len(self.plant.sampling.readings))
        return tuple(kept + jump for jump in self.observer.jumps or alike)
