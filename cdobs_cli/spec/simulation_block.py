"""The block `simulation`: what is run, from where, under which signals."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import ConfigDict, Field, PlainValidator, ValidationInfo, WithJsonSchema

from cdobs_cli.errors import Problem
from cdobs_cli.exact.expression import Call, Expression, Number, Variable
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.exact.parser import CONSTANTS, TYPED_FUNCTIONS
from cdobs_cli.fields import NAME, PositiveNumber, Vector, context, formula, read_expression, sized, wrong
from cdobs_cli.run import ESTIMATE, SimulationPlan
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.spec.block import Block, unknown_key
from cdobs_cli.spec.boxes import MAX_STATES, BoxBlock, box_problems, length_problem, ordered

MAX_RUNS = 100_000
MAX_SAMPLES = 1_000_000
# Drawn anew at every sample, from the seed: uniform in [lo, hi], normal with deviation sigma.
NOISE_FUNCTIONS = {**TYPED_FUNCTIONS, "uniform": (2,), "normal": (1,)}

OfTime = Annotated[Expression, formula("t")]


def _input_signal(value: Any, info: ValidationInfo) -> Expression:
    """A function of t, of the estimate (`hat.<state>` for a state's name) and of the last measurement (`y.0`, .. for
    y, or y1, y2, ..; a state, an input or a parameter of such a name comes first)."""
    if isinstance(value, Expression):
        return value
    if isinstance(value, bool) or not isinstance(value, int | str):
        raise wrong("an expression is expected")
    text, parameters = str(value), context(info, "parameters") or {}
    written = NAME.findall(text)
    states, inputs, outputs = (context(info, name) for name in ("states", "inputs", "outputs"))
    for name in written:
        if name in (inputs or ()) and name not in TYPED_FUNCTIONS:
            raise wrong(f"{name} is an input, which has no estimate: a signal reads t, {_READ}")
    meant = {f"y{k + 1}": Variable(f"y.{k}") for k in range(MAX_STATES if outputs is None else outputs)}
    if len(meant) == 1 or outputs is None:
        meant["y"] = Variable("y.0")
    taken = {*parameters, *(inputs or ())}
    meant = {name: one for name, one in meant.items() if name not in taken}
    # Where the states are not known their names are told of there: any name passes.
    known = set(written) - {*TYPED_FUNCTIONS, *CONSTANTS, "t", *taken, *meant} if states is None else states
    meant |= {name: Variable(f"{ESTIMATE}{name}") for name in known}
    return read_expression(text, {"t", *meant}, parameters).substitute(meant)


_READ = "the estimate (by the names of the states) and the last measurement y (y1, y2, .. of several)"
InputSignal = Annotated[
    Expression,
    PlainValidator(_input_signal),
    WithJsonSchema({"anyOf": [{"type": "string"}, {"type": "number"}], "description": f"An expression of t, {_READ}."}),
]
Noise = Annotated[Expression, formula("t", functions=NOISE_FUNCTIONS)]


class SignalsBlock(Block):
    """Inputs by name, `d` the disturbance, `v` the noise at samples: expressions of t, inputs also of the estimate and
    of the last measurement. Without `d` or `v` they are drawn, with the seed, within what is declared."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, defer_build=True)
    __pydantic_extra__: dict[str, InputSignal]
    d: Annotated[tuple[OfTime, ...], sized(1, MAX_STATES)] | None = Field(
        default=None,
        description="The disturbance, an expression of t for each state, within what is declared; drawn where left "
        "out.",
    )
    v: Annotated[tuple[Noise, ...], sized(1, MAX_STATES)] | None = Field(
        default=None,
        description="The noise of each output, an expression of t, also with uniform(lower, upper) and "
        "normal(deviation); drawn where left out.",
    )

    @property
    def inputs(self) -> dict[str, Expression]:
        """The expressions of the inputs, by name."""
        return dict(self.__pydantic_extra__ or {})


class SimulationBlock(Block):
    """One run from `initial_state`, or `runs` from `initial_box`."""

    required: ClassVar[tuple[str, ...]] = ("horizon",)
    horizon: PositiveNumber | None = Field(default=None, description="How long is simulated, from t = 0.")
    initial_state: Vector | None = Field(default=None, description="Where the plant starts, a number for each state.")
    initial_box: BoxBlock | None = Field(
        default=None,
        description="Instead: where it may start. Runs start at random in it; transients are proved from all of it.",
    )
    initial_estimate: Vector | None = Field(
        default=None, description="Where the estimate starts; the middle of initial_box, or 0, where left out."
    )
    runs: Annotated[int, Field(strict=True, ge=1, le=MAX_RUNS)] = Field(
        default=1, description="How many runs there are, each with draws of its own."
    )
    seed: Annotated[int, Field(strict=True, ge=0, lt=2**63)] = Field(
        default=0, description="Of all draws: the same seed gives the same runs."
    )
    signals: SignalsBlock | None = Field(
        default=None, description="What the inputs are, and the disturbance and noise where they are not to be drawn."
    )
    sampling_times: Annotated[Expression, formula("t_k")] | None = Field(
        default=None,
        description="The time from the sample at t_k to the next, an expression of t_k within the sampling law; drawn "
        "where left out.",
    )
    delays: Annotated[
        Literal["random", "latest"] | None,
        Field(description="Of late measurements: drawn uniformly from their intervals, or as late as may be."),
    ] = None


def simulation_problems(
    simulation: SimulationBlock, wrong_fields: set[str], *, states: tuple[str, ...] | None,
    inputs: tuple[str, ...] | None, outputs: int | None, disturbed: bool, noisy: bool, law: SamplingLaw | None,
    late: bool,
) -> Iterator[Problem]:  # fmt: skip
    """Lengths, a start, a number of samples that can be run, a signal for what needs one."""
    at = ("simulation",)
    n = None if states is None else len(states)
    box = simulation.initial_box
    if n is not None:
        for name in ("initial_state", "initial_estimate"):
            yield from length_problem((*at, name), getattr(simulation, name), n, "one number for each state")
    if box is not None:
        yield from box_problems(box, (*at, "initial_box"), n, "state")
    if simulation.initial_state is None and box is None and not wrong_fields & {"initial_state", "initial_box"}:
        yield Problem((*at, "initial_state"), "is required, or initial_box")
    if simulation.initial_state is not None and box is not None and box.lower is not None and box.upper is not None:
        for i, (lower, value, upper) in enumerate(zip(box.lower, simulation.initial_state, box.upper, strict=False)):
            if ordered(lower, upper) and not (ordered(lower, value) and ordered(value, upper)):
                yield Problem((*at, "initial_state", i), "lies outside initial_box", str(value), f"{lower} to {upper}")
    horizon = simulation.horizon
    longest = (
        None
        if law is None or law.is_updated or (law.is_on_change and not law.is_checked)
        else law.period * Exact(MAX_SAMPLES)
    )
    if horizon is not None and longest is not None and not ordered(horizon, longest):
        yield Problem((*at, "horizon"), "too many samples", str(horizon), f"at most {MAX_SAMPLES} periods")
    if simulation.delays is not None and not late:
        yield Problem((*at, "delays"), "needs measurements that arrive late: measurement.delay, which is not given")
    signals = simulation.signals or SignalsBlock.model_construct()
    for i, expression in enumerate(signals.v or ()):
        yield from _draw_problems(expression, (*at, "signals", "v", i))
    yield from _signal_problems(signals, wrong_fields, n, inputs, outputs, disturbed, noisy)


def _draw_problems(expression: Expression, at: tuple[str | int, ...]) -> Iterator[Problem]:
    """Draws that cannot be made, as far as their arguments are numbers."""
    for node in expression.walk():
        if isinstance(node, Call) and node.function in ("uniform", "normal"):
            values = [child.value for child in node.children if isinstance(child, Number)]
            if node.function == "uniform" and len(values) == 2 and values[0] > values[1]:
                yield Problem(at, "the lower end is above the upper end", str(node))
            if node.function == "normal" and values and values[0] < 0:
                yield Problem(at, "a deviation is not negative", str(node))


def _signal_problems(
    signals: SignalsBlock, wrong_fields: set[str], n: int | None, inputs: tuple[str, ...] | None, outputs: int | None,
    disturbed: bool, noisy: bool,
) -> Iterator[Problem]:  # fmt: skip
    at = ("simulation", "signals")
    given, inputs = signals.inputs, tuple(signals.inputs) if inputs is None else inputs
    for name in given:
        if name not in inputs:
            yield unknown_key(at, name, [*inputs, "d", "v"])
    if "signals" not in wrong_fields:
        for name in inputs:
            if name not in given:
                yield Problem(at, f"the input {name} has no signal", hint=f'add {name}: "0", or an expression of t')
    if signals.d is not None:
        if not disturbed:
            yield Problem((*at, "d"), "needs plant.disturbance, which is not given")
        elif n is not None:
            yield from length_problem((*at, "d"), signals.d, n, "one expression for each state")
    if signals.v is not None:
        if not noisy:
            yield Problem((*at, "v"), "needs measurement.noise, which is not given")
        elif outputs is not None:
            yield from length_problem((*at, "v"), signals.v, outputs, "one expression for each output")


def plan(block: SimulationBlock) -> SimulationPlan:
    """The noun of a block without problems."""
    assert block.horizon is not None
    signals: dict[str, Expression] = {}
    if block.signals is not None:
        signals |= block.signals.inputs
        signals |= {f"d.{i}": expression for i, expression in enumerate(block.signals.d or ())}
        signals |= {f"v.{i}": expression for i, expression in enumerate(block.signals.v or ())}
    times = block.sampling_times
    typed_times = None if times is None else times.substitute({"t_k": Variable("t")})
    box, start = None if block.initial_box is None else block.initial_box.box(), block.initial_estimate
    return SimulationPlan(
        block.horizon, block.initial_state, box, start, block.runs, block.seed, signals, typed_times,
        block.delays == "latest",
    )  # fmt: skip
