"""The block `plant`: its fields, their shapes, and the noun made of them."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated, Any, ClassVar, Literal

from pydantic import AfterValidator, BeforeValidator, ConfigDict, Discriminator, Field, Tag, WithJsonSchema

from cdobs_cli.delays import Delay
from cdobs_cli.errors import Problem
from cdobs_cli.exact.expression import Expression
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.fields import Rows, formula, sized, wrong
from cdobs_cli.plant import CoordinateMap, Domain, Input, Plant, TypedDynamics
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.spec.block import Block, Name, Text, unknown_key
from cdobs_cli.spec.boxes import MAX_STATES, IntervalField, length_problem, shape_problem
from cdobs_cli.spec.domain_block import DomainBlock
from cdobs_cli.spec.noise_block import DisturbanceBlock, NoiseBlock, disturbance_problems
from cdobs_cli.spec.slopes_block import SlopesField, slopes

MAX_INPUTS = 16
MAX_PARAMETERS = 100
_NORMAL_FORM = ("A", "phi", "lipschitz")
# Names that mean something else where a name of this kind stands.
_MEANT = {
    ("inputs", "d"): "disturbance", ("inputs", "v"): "noise", ("states", "where"): "inequalities of a domain",
}  # fmt: skip


class InputBlock(Block):
    """A known input; `range` where its values lie."""

    range: IntervalField | None = Field(
        default=None, description="Where its values lie: [lower, upper]. What is proved holds for all of them."
    )


def _formulas(*names: str, largest: int = MAX_STATES) -> Any:
    return Annotated[tuple[Annotated[Expression, formula(*names)], ...], sized(1, largest)]


class MapBlock(Block):
    """z = map(x), x = inverse(z)."""

    required: ClassVar[tuple[str, ...]] = ("map", "inverse")
    map: _formulas("states") | None = Field(  # type: ignore[valid-type]
        default=None, description="z as functions of the states, one for each."
    )
    inverse: _formulas("coordinates") | None = Field(  # type: ignore[valid-type]
        default=None,
        description="The states as functions of z, named x1, x2, .. (z1, z2, .. where that is taken); that it undoes "
        "the map is proved.",
    )


# Names of union members hold a space: no key of a spec is taken for one.
CoordinatesField = Annotated[
    Annotated[Literal["lie"], Tag("one word")] | Annotated[MapBlock, Tag("typed map")],
    Discriminator(lambda value: "typed map" if isinstance(value, dict | MapBlock) else "one word"),
]


def _label(value: str) -> str:
    if not _LABEL.fullmatch(value):
        raise wrong(f"a label of a unit is up to {MAX_LABEL} letters, digits, spaces and any of / * ^ . - ( ) %")
    return value


def _listed(value: Any) -> Any:
    return list(value) if isinstance(value, dict) else value


MAX_LABEL = 16
_LABEL = re.compile(rf"(?=\S)[\w °%/*^.·()⁰¹²³⁻-]{{1,{MAX_LABEL}}}(?<=\S)")
Label = Annotated[Text, AfterValidator(_label)]
_names: dict[str, Any] = {"type": "array", "items": {"type": "string"}, "minItems": 1, "maxItems": MAX_STATES}
_labelled = {"type": "object", "additionalProperties": {"anyOf": [{"type": "string"}, {"type": "null"}]}}
# A list of names, or names with labels of their units (`labels_of` reads these).
StatesField = Annotated[
    tuple[Name, ...],
    sized(1, MAX_STATES),
    BeforeValidator(_listed),
    WithJsonSchema({"anyOf": [_names, _labelled], "description": "Names, or names with labels of their units."}),
]


class LabelsBlock(Block):
    """name: label of its unit."""

    model_config = ConfigDict(extra="allow", frozen=True, arbitrary_types_allowed=True, defer_build=True)
    __pydantic_extra__: dict[str, Label | None]


# Read one after the other by the loader: a value may use the parameters above it.
Parameter = Annotated[Any, WithJsonSchema({"anyOf": [{"type": "number"}, {"type": "string"}]})]


class PlantBlock(Block):
    """xdot = A x + phi(x, u) + B u + d with bounds of the slopes of phi, or xdot = f(x, u), y = h(x, u).

    Outputs need not be linear: their slopes over the domain are found and proved, and known inputs are subtracted.
    With `coordinates` they are linear in these."""

    required: ClassVar[tuple[str, ...]] = ("states",)
    time_unit: Label | None = Field(
        default=None, description="A label: every time, period and rate bears it. No number is converted."
    )
    states: StatesField | None = Field(
        default=None, description="The states' names, in order; or each with the label of its unit."
    )
    inputs: dict[Name, InputBlock | None] | None = Field(
        default=None, description="Inputs that the observer knows, by name: {} or {range: [lower, upper]}."
    )
    parameters: dict[Name, Parameter] | None = Field(
        default=None,
        description="Numbers by name, for use in every number and expression of the spec; one may use those above it.",
    )
    A: Rows | None = Field(default=None, description="The linear part of the plant, a row and a column for each state.")
    phi: _formulas("coordinates", "inputs") | None = Field(  # type: ignore[valid-type]
        default=None, description="The nonlinear part, an expression of states and inputs for each state."
    )
    B: Rows | None = Field(
        default=None,
        description="How inputs enter: a row for each state, a column for each input. Left out: not at all, but in "
        "phi.",
    )
    lipschitz: SlopesField | None = Field(
        default=None,
        description="Bounds of the slopes of phi, which are proved: a row for each function, a column for each state; "
        "or auto, which finds them.",
    )
    domain: DomainBlock | None = Field(
        default=None, description="Where the slopes are claimed; everywhere where left out."
    )
    disturbance: DisturbanceBlock | None = Field(
        default=None, description="What is added to xdot and not known: a box, or white of an intensity."
    )
    dynamics: _formulas("states", "inputs") | None = Field(  # type: ignore[valid-type]
        default=None,
        description="Instead of A, phi and lipschitz: xdot, an expression of states and inputs for each state.",
    )
    output: _formulas("states", "inputs") | None = Field(  # type: ignore[valid-type]
        default=None, description="With dynamics, instead of C: what is measured, expressions of states and inputs."
    )
    coordinates: CoordinatesField | None = Field(
        default=None,
        description="With dynamics, where the design is made in other coordinates: lie (those of the output and its "
        "derivatives), or a map and its inverse.",
    )


def plant_problems(
    plant: PlantBlock, wrong_fields: set[str], states: tuple[str, ...] | None, inputs: tuple[str, ...] | None,
    *, sensors: bool = False,
) -> Iterator[Problem]:  # fmt: skip
    """Names, and shapes against the number of states and inputs as typed; `wrong_fields` are already told. sensors:
    whether these have the outputs."""

    def at(*path: str | int) -> tuple[str | int, ...]:
        return ("plant", *path)

    yield from _name_problems(plant)
    if plant.dynamics is None and "dynamics" not in wrong_fields:
        missing = [name for name in _NORMAL_FORM if getattr(plant, name) is None and name not in wrong_fields]
        if missing == [*_NORMAL_FORM]:
            yield Problem(at(), "what the plant is made of is required: A, phi and lipschitz, or dynamics and output")
            missing = []
        elif missing == [*_NORMAL_FORM[1:]]:
            yield Problem(at("phi"), "phi and lipschitz are required", hint=_linear(len(states or ())))
            missing = []
        for name in missing:
            yield Problem(at(name), "is required", hint="or type the plant as `dynamics` and `output`")
        for name in ("output", "coordinates"):
            if getattr(plant, name) is not None:
                yield Problem(at(name), "goes with `dynamics`, which is not given")
    elif plant.dynamics is not None and plant.output is None and "output" not in wrong_fields and not sensors:
        yield Problem(at("output"), "is required with `dynamics`")
    for name, count in (("inputs", MAX_INPUTS), ("parameters", MAX_PARAMETERS)):
        if len(getattr(plant, name) or ()) > count:
            yield Problem(at(name), f"at most {count} are taken", str(len(getattr(plant, name) or ())))
    if states is None:
        return
    n = len(states)
    if plant.A is not None:
        yield from shape_problem(at("A"), plant.A.shape, (n, n), "a row and a column for each state")
    if plant.B is not None and inputs is not None:
        if not inputs:
            yield Problem(at("B"), "needs `inputs`, none is declared")
        else:
            rows = "a row for each state, a column for each input"
            yield from shape_problem(at("B"), plant.B.shape, (n, len(inputs)), rows)
    for name in ("phi", "dynamics"):
        yield from length_problem(at(name), getattr(plant, name), n, "one expression for each state")
    if isinstance(plant.coordinates, MapBlock):
        for name in ("map", "inverse"):
            typed = getattr(plant.coordinates, name)
            if typed is None:
                yield Problem(at("coordinates", name), "is required")
            yield from length_problem(at("coordinates", name), typed, n, "one expression for each state")
    if isinstance(plant.lipschitz, tuple):
        yield from length_problem(at("lipschitz"), plant.lipschitz, n, "one row for each state")
        for i, row in enumerate(plant.lipschitz):
            yield from length_problem(at("lipschitz", i), row, n, "one slope for each state")
    if plant.domain is not None:
        for name in plant.domain.__pydantic_extra__ or {}:
            if name not in states:
                yield unknown_key(at("domain"), name, [*states, "where"])
    if plant.disturbance is not None:
        moved = plant.coordinates is not None
        yield from disturbance_problems(plant.disturbance, at("disturbance"), n, moved=moved)


def _linear(n: int) -> str:
    """What a linear plant is typed with beside A."""
    short = 0 < n <= 4  # states of which the matrix is shown
    phi = ", ".join(['"0"'] * n) if short else '"0", ..'
    rows = ", ".join(["[" + ", ".join("0" * n) + "]"] * n) if short else "[0, ..], .."
    return f"of a linear plant write phi: [{phi}] and lipschitz: [{rows}]; or type `dynamics` and `output`"


def _name_problems(plant: PlantBlock) -> Iterator[Problem]:
    seen: dict[str, str] = {}
    for kind in ("states", "inputs", "parameters"):
        for i, name in enumerate(getattr(plant, kind) or ()):
            place: tuple[str | int, ...] = ("plant", kind, i if kind == "states" else name)
            if name in seen:
                yield Problem(place, f"the name {name} is already one of the {seen[name]}")
            seen.setdefault(name, kind)
            if (kind, name) in _MEANT:
                yield Problem(place, f"the name {name} stands for the {_MEANT[kind, name]}")


def typed_plant(
    plant: PlantBlock,
    C: ExactMatrix | None,
    sampling: SamplingLaw,
    noise: NoiseBlock | None,
    names: tuple[str, ...],
    delays: tuple[Delay, ...] = (),
) -> Plant | TypedDynamics:
    """The noun behind a block without problems; `names` are of the states that A and phi are in."""
    assert plant.states is not None
    n = len(plant.states)
    blocks = (plant.inputs or {}).items()
    common: dict[str, Any] = {
        "states": plant.states, "B": plant.B, "sampling": sampling, "delays": delays,
        "inputs": tuple(Input(name, None if one is None else one.range) for name, one in blocks),
        "domain": Domain() if plant.domain is None else plant.domain.domain(),
        "disturbance": None if plant.disturbance is None else plant.disturbance.box,
        "intensity": None if plant.disturbance is None else plant.disturbance.intensity,
        "noise": None if noise is None else noise.box,
        "covariance": None if noise is None else noise.second_moment,
    }  # fmt: skip
    if plant.dynamics is None:
        assert plant.A is not None and plant.phi is not None and C is not None
        return Plant(A=plant.A, phi=plant.phi, C=C, slopes=slopes(plant.lipschitz, n), **common).without_zero_slopes()
    coordinates: CoordinateMap | Literal["lie"] | None = None
    if plant.coordinates == "lie":
        coordinates = "lie"
    elif isinstance(plant.coordinates, MapBlock):
        assert plant.coordinates.map is not None and plant.coordinates.inverse is not None
        coordinates = CoordinateMap(names, plant.coordinates.map, plant.coordinates.inverse)
    assert plant.output is not None
    return TypedDynamics(
        dynamics=plant.dynamics, output=plant.output, coordinates=coordinates, names=names, A=plant.A, phi=plant.phi,
        C=C, slopes=None if plant.lipschitz is None else slopes(plant.lipschitz, n), **common,
    )  # fmt: skip
