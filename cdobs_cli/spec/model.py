"""The spec: a file read, every block of it checked, all mistakes told at once, and the nouns that come out."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import field, fields, is_dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

from pydantic import BaseModel, Field
from pydantic_core import PydanticCustomError

from cdobs_cli.codec import OPTIONAL
from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact.budget import READING, WorkError, budget
from cdobs_cli.exact.expression import Expression, Number
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import nearest
from cdobs_cli.families import FAMILIES, Family
from cdobs_cli.fields import read_exact
from cdobs_cli.labels import SECONDS, Labels
from cdobs_cli.plant import Plant, TypedDynamics, coordinate_names
from cdobs_cli.records import dataclass
from cdobs_cli.run import SimulationPlan
from cdobs_cli.spec.auto_block import AUTO, AutoBlock, Choice
from cdobs_cli.spec.block import Block, Text, is_identifier, placed, read_block, unknown_key
from cdobs_cli.spec.boxes import MAX_STATES
from cdobs_cli.spec.elsewhere import Typed, word_for
from cdobs_cli.spec.expect import Expectation, ExpectBlock, expect_problems, expectation
from cdobs_cli.spec.gain_file import gain_of_file, letters_of
from cdobs_cli.spec.limits import limit_problems
from cdobs_cli.spec.measurement_block import (
    MeasurementBlock,
    late,
    measurement_problems,
    sampling_law,
    together,
    without_misshapen,
)
from cdobs_cli.spec.plant_block import MAX_LABEL, MAX_PARAMETERS, LabelsBlock, PlantBlock, plant_problems, typed_plant
from cdobs_cli.spec.plant_file import read_plant_file
from cdobs_cli.spec.reader import MAX_PROBLEMS, Document, FieldPath, read, shown
from cdobs_cli.spec.report_block import ReportBlock
from cdobs_cli.spec.simulation_block import SimulationBlock, plan, simulation_problems

if TYPE_CHECKING:
    from cdobs_cli.coordinates import Coordinates

MAX_EXPECTATIONS = 200


class Header(Block):
    """The keys of a spec; its blocks are read one by one."""

    required: ClassVar[tuple[str, ...]] = ("spec_version", "plant", "measurement")
    spec_version: Literal[1] | None = None
    title: Annotated[Text, Field(max_length=200)] | None = None
    plant: Any = None
    measurement: Any = None
    observer: Any = None
    simulation: Any = None
    report: Any = None
    expect: Any = None


@dataclass(frozen=True)
class Spec:
    """A spec without mistakes.

    coordinates: the way back to the states that the user typed, where `plant` and `simulation` are not in them;
    signals: of the inputs, over the estimates of the states that the user typed. labels: of units; results do not
    depend on them. choice: what the observer is chosen from, where the spec leaves that open; `observer` is the first
    that takes the plant until then. figures: the formats that are drawn.
    """

    title: str
    plant: Plant
    observer: Family
    simulation: SimulationPlan | None
    expect: tuple[Expectation, ...]
    source_path: Path
    document: Document
    typed: TypedDynamics | None = None
    coordinates: Coordinates | None = None
    signals: Mapping[str, Expression] = field(default_factory=dict)
    labels: Labels = field(default_factory=Labels)
    choice: Choice | None = None
    figures: tuple[str, ...] = ("svg",)

    def chosen(self, family: str) -> Spec:
        """With a family of the choice as its observer; the spec itself where its family was typed."""
        return self if self.choice is None else replace(self, observer=self.choice.cards[family])

    def location(self, path: FieldPath) -> tuple[str, int, int]:
        """File, line and column of a value, or of the nearest thing around it that was typed."""
        place = self.document.place(tuple(path))
        return place.file, place.line, place.column

    def normalised(self) -> dict[str, Any]:
        """The content that results depend on, as JSON: exact numbers as text; comments and title do not show."""
        plant = canonical(self.typed or self.plant)
        measurement = {name: plant.pop(name) for name in ("C", "sampling", "noise", "covariance")}
        measurement |= {"delays": plant.pop("delays")} if "delays" in plant else {}
        rest = {name: canonical(getattr(self, name)) for name in ("observer", "simulation", "expect")}
        if self.choice is not None:
            rest["observer"] = canonical(self.choice.block)
        return {"plant": plant, "measurement": measurement, **rest}


def canonical(value: Any) -> Any:
    """JSON-able content of a noun or block: equal for equal meaning, exact numbers as text."""
    if value is None or isinstance(value, bool | int):
        return value
    if isinstance(value, str | Exact | Expression | Fraction):
        return str(value)
    if isinstance(value, ExactMatrix):
        return value.texts()
    if isinstance(value, BaseModel):
        return {name: canonical(getattr(value, name)) for name in type(value).model_fields}
    if is_dataclass(value):
        told = ((part, getattr(value, part.name)) for part in fields(value))
        return {part.name: canonical(one) for part, one in told if one or not part.metadata.get(OPTIONAL)}
    if isinstance(value, Mapping):
        return {str(name): canonical(value[name]) for name in value}
    if isinstance(value, frozenset | set):
        return sorted(canonical(entry) for entry in value)
    if isinstance(value, tuple | list):
        return [canonical(entry) for entry in value]
    raise TypeError(f"no canonical form of {type(value).__name__}")


def load(path: str | Path) -> Spec:
    """Read and check a spec.

    The work is bounded: see `exact.budget`.

    Raises:
        SpecError: every mistake that was found, each with file, line and column.
    """
    path = Path(path)
    return load_document(read(path), path)


def load_document(document: Document, path: Path) -> Spec:
    """Check what was read. Raises: SpecError, as `load`."""
    loader = _Loader(document, path)
    with warnings.catch_warnings():
        # Python warns of odd literals in typed expressions; they are refused in our own words.
        warnings.simplefilter("ignore")
        try:
            with budget(READING):
                return loader.load()
        except WorkError as error:
            raise loader.too_much(error) from None


def with_files(document: Document, path: Path) -> Document:
    """The document with what its files hold, plant and gain, in the place of their names. Raises: SpecError."""
    loader = _Loader(document, path)
    if isinstance(document.root, dict):
        loader.include_plant_file(document.root)
        loader.include_gain_file(document.root)
    if loader.failed:
        raise loader.fail()
    return document


class _Loader:
    def __init__(self, document: Document, path: Path) -> None:
        self.document, self.path = document, path
        self.problems: list[Problem] = []

    def fail(self) -> SpecError:
        """All problems in the order of the text; not those about values that the reader refused."""
        refused = self.document.refused
        own = [one for one in self.problems if not any(one.field[: len(path)] == path for path in refused)]
        kept = [placed(problem, self.document) for problem in own]
        unique = dict.fromkeys([*self.document.problems, *kept])
        file = self.document.file
        told = sorted(unique, key=lambda one: (one.file != file, one.file or "", one.line or 0, one.column or 0))
        if len(told) > MAX_PROBLEMS:
            more = Problem((), f"{len(told) - MAX_PROBLEMS} more mistakes are not shown", file=file)
            told = [*told[:MAX_PROBLEMS], more]
        return SpecError(tuple(told))

    def too_much(self, error: WorkError) -> SpecError:
        """Where the work is used up: coordinates cost most, and their user can save it."""
        at: FieldPath = ("plant", "coordinates") if ("plant", "coordinates") in self.document.values else ("plant",)
        hint = "type `map` and `inverse`" if self.document.value(at) == "lie" else "shorten the expressions"
        self.tell(at, str(error), hint=hint)
        return self.fail()

    def tell(
        self, field: FieldPath, what: str, got: str | None = None, allowed: str | None = None, hint: str | None = None
    ) -> None:
        self.problems.append(Problem(field, what, got, allowed, hint))

    @property
    def failed(self) -> bool:
        return bool(self.problems or self.document.problems)

    def block(self, model: type[Any], value: Any, at: FieldPath, context: dict[str, Any]) -> tuple[Any, set[str]]:
        block, wrong_fields, problems = read_block(model, value, at, context)
        self.problems += problems
        return block, wrong_fields

    def load(self) -> Spec:
        root = self.document.root
        if not isinstance(root, dict):
            self.tell((), "a mapping is expected", shown(root), ", ".join(Header.model_fields))
            raise self.fail()
        self.include_plant_file(root)
        self.include_gain_file(root)
        header, _ = self.block(Header, root, (), {})
        context = self.context(root.get("plant"))

        plant, plant_wrong = self.section(PlantBlock, root.get("plant"), "plant", context)
        measurement, measurement_wrong = self.section(MeasurementBlock, root.get("measurement"), "measurement", context)
        plant_wrong |= _told_there(root, "plant")
        measurement_wrong |= _told_there(root, "measurement")
        sensed = measurement is not None and (measurement.sensors is not None or "sensors" in measurement_wrong)
        if plant is not None:
            known = context["states"], context["inputs"]
            self.problems += plant_problems(plant, plant_wrong, *known, sensors=sensed)
        labels = self.labels(root.get("plant"), plant)
        if measurement is not None:
            self.problems += measurement_problems(measurement, measurement_wrong, plant, context["states"])
            measurement = without_misshapen(measurement, context["states"])
        if sensed:  # of sensors with a mistake nothing more is known
            right = plant is not None and not self.failed
            plant, measurement = together(plant, measurement) if right else (plant, None)
        # The observer's own expressions are over the states that the plant ends up in.
        family = self.family(root.get("observer"), {**context, "states": context["coordinates"]})
        seen = {**context, "outputs": _outputs(plant, measurement)}
        simulation, simulation_wrong = self.section(SimulationBlock, root.get("simulation"), "simulation", seen)
        simulation_wrong |= _told_there(root, "simulation")
        if simulation is not None:
            law = (
                None
                if measurement is None or not measurement.has_law
                else sampling_law(measurement, _outputs(plant, measurement))
            )
            self.problems += simulation_problems(
                simulation, simulation_wrong,
                states=context["states"], inputs=self.signalled(context["inputs"], family),
                outputs=_outputs(plant, measurement),
                disturbed=plant is None or plant.disturbance is not None or "disturbance" in plant_wrong,
                noisy=measurement is None or measurement.noise is not None or "noise" in measurement_wrong, law=law,
                late=measurement is None or measurement.has_delay or bool(measurement_wrong & {"delay", "sensors"}),
            )  # fmt: skip
        report, _ = self.section(ReportBlock, root.get("report"), "report", {})
        expect = self.expectations(root.get("expect"))
        if self.failed:
            raise self.fail()

        names = tuple(context["coordinates"])
        outputs = _outputs(plant, measurement)
        law, delays = sampling_law(measurement, outputs), late(measurement, outputs or 0)
        typed = typed_plant(plant, measurement.C, law, measurement.noise, names, delays)
        asked = None if simulation is None else plan(simulation)
        self.problems += () if asked is None else limit_problems(typed, asked)
        final, run, coordinates = self.derive(typed, asked)
        choice = None
        if isinstance(family, AutoBlock):
            choice = Choice.of(family, final, run)
            self.problems += () if choice.problem is None else (choice.problem,)
            family = next(iter(choice.cards.values()), None)
        elif family is not None:
            self.problems += family.mistakes(final, run)
        if self.failed or family is None:
            raise self.fail()
        if choice is None:
            family = family.resolved(final, None if run is None else float(run.horizon))
        entries = tuple(expectation(block, ("expect", i)) for i, block in enumerate(expect))
        return Spec(
            title=header.title or self.path.stem, plant=final, observer=family, simulation=run, expect=entries,
            source_path=self.path, document=self.document,
            typed=typed if isinstance(typed, TypedDynamics) else None, coordinates=coordinates,
            signals={} if asked is None else asked.inputs, labels=labels,
            choice=choice, figures=(report or ReportBlock()).figures,
        )  # fmt: skip

    def labels(self, typed: Any, plant: PlantBlock | None) -> Labels:
        """Of the units of time and states."""
        listed = typed.get("states") if isinstance(typed, dict) else None
        states: dict[str, str] = {}
        if isinstance(listed, dict):
            block, _ = self.block(LabelsBlock, listed, ("plant", "states"), {})
            states = {} if block is None else {name: one for name, one in block.__pydantic_extra__.items() if one}
        time = None if plant is None else plant.time_unit
        return Labels(time or SECONDS, states)

    def section(self, model: type[Any], value: Any, name: str, context: dict[str, Any]) -> tuple[Any, set[str]]:
        return (None, set()) if value is None else self.block(model, value, (name,), context)

    def include_plant_file(self, root: dict[str, Any]) -> None:
        """`plant: {file: name}`: the file's content stands in the place of the block."""
        plant = root.get("plant")
        if not isinstance(plant, dict) or "file" not in plant:
            return
        at: FieldPath = ("plant", "file")
        name = plant["file"]
        for other in (key for key in plant if key != "file"):
            self.tell(("plant", other), "goes into the plant's file", hint="`file` stands alone")
        if not isinstance(name, str) or not name:
            self.document.problems.append(placed(Problem(at, "a file name is expected", shown(name)), self.document))
            root["plant"] = None
            self.document.refused.add(("plant",))
            return
        try:
            included = read_plant_file(self.path, name)
        except SpecError as error:
            self.problems += [self.included_problem(problem, at) for problem in error.problems]
            raise self.fail() from None
        if isinstance(included.root, dict) and "file" in included.root:
            place = included.place(("file",), key=True)
            nested = Problem(at, "a plant's file names no further file")
            self.problems.append(replace(nested, file=place.file, line=place.line, column=place.column))
            raise self.fail()
        self.problems = [placed(problem, self.document) for problem in self.problems]
        self.document.graft(("plant",), included)

    def include_gain_file(self, root: dict[str, Any]) -> None:
        """`gain: {file: name}`: the matrices of the file stand in the place of its name."""
        observer = root.get("observer")
        gain = observer.get("gain") if isinstance(observer, dict) else None
        letters = letters_of(observer.get("family")) if isinstance(observer, dict) else ()
        if not isinstance(gain, dict) or "file" not in gain or not letters:
            return
        at: FieldPath = ("observer", "gain")
        try:
            found = gain_of_file(self.path, gain, letters)
        except SpecError as error:
            self.document.problems += [placed(problem, self.document) for problem in error.problems]
            self.document.refused.add(at)
            found = None
        self.document.graft(at, Document(self.document.file, found))

    def included_problem(self, problem: Problem, at: FieldPath) -> Problem:
        # What is wrong with the file as a whole is to be looked for where it is named.
        where = problem if problem.line is not None else self.document.place(at)
        got = problem.got or problem.file
        return replace(problem, field=at, got=got, file=where.file, line=where.line, column=where.column)

    def context(self, plant: Any) -> dict[str, Any]:
        """Names for every expression below, as far as they can be read. What is wrong among them is told where
        it stands, not again at each use: None lets any name pass."""
        if not isinstance(plant, dict):
            return {"parameters": {}, "states": None, "inputs": None, "coordinates": None, "time_unit": SECONDS}
        typed_unit = plant.get("time_unit")
        time_unit = typed_unit if isinstance(typed_unit, str) and len(typed_unit) <= MAX_LABEL else SECONDS
        listed = plant.get("states")
        states = _names(list(listed) if isinstance(listed, dict) else listed, list)
        inputs = _names(plant.get("inputs") or {}, dict)
        parameters: dict[str, Expression] = {}
        typed = plant.get("parameters")
        for name, value in list(typed.items())[: MAX_PARAMETERS + 1] if isinstance(typed, dict) else []:
            try:
                parameters[name] = read_exact(value, dict(parameters), time_unit).expression
            except PydanticCustomError as error:
                told = (error.context or {}).get("hint")
                self.tell(("plant", "parameters", name), str(error), shown(value), hint=told)
                parameters[name] = Number(1)
        coordinates = states
        if plant.get("coordinates") is not None and states is not None:
            coordinates = coordinate_names(len(states), frozenset([*states, *(inputs or ()), *parameters]))
        names = {"states": states, "inputs": inputs, "coordinates": coordinates}
        return {"parameters": parameters, "time_unit": time_unit, **names}

    def family(self, value: Any, context: dict[str, Any]) -> Family | AutoBlock | None:
        if value is None:
            return AutoBlock()
        if not isinstance(value, dict):
            hint = f"write observer: {{family: {value}}}" if value in (*FAMILIES, AUTO) else None
            self.tell(("observer",), "a mapping is expected", shown(value), "family, and what it takes", hint)
            return None
        name = value.get("family")
        if name is None and (other := self.family_word(value)) is not None:
            self.problems.append(other)
            return None
        if name == AUTO:
            block: AutoBlock | None = self.block(AutoBlock, value, ("observer",), context)[0]
            return block
        if not isinstance(name, str) or name not in FAMILIES:
            what = "is required" if name is None else "unknown family"
            hint = nearest(name, [*FAMILIES, AUTO])[2:] or None if isinstance(name, str) else None
            got = None if name is None else shown(name)
            self.tell(("observer", "family"), what, got, ", ".join((*FAMILIES, AUTO)), hint)
            return None
        family: Family | None = self.block(FAMILIES[name], value, ("observer",), context)[0]
        return family

    def family_word(self, value: dict[str, Any]) -> Problem | None:
        """Another word for `family`, told in its place."""
        for key, typed in value.items():
            if (word_for(("observer",), key, Typed(typed), ["family"]) or ("",))[0] == "family":
                return unknown_key(("observer",), key, ["family"], Typed(typed))
        return None

    def signalled(self, inputs: tuple[str, ...] | None, family: Family | AutoBlock | None) -> tuple[str, ...] | None:
        """The inputs that need a signal: all but those that the observer itself sets; None: not known."""
        if inputs is None or family is None or isinstance(family, AutoBlock):
            return inputs
        controlled = family.controlled(inputs)
        return tuple(name for name in inputs if name not in controlled)

    def expectations(self, value: Any) -> list[ExpectBlock]:
        if value is None:
            return []
        if not isinstance(value, list) or len(value) > MAX_EXPECTATIONS:
            self.tell(("expect",), f"a list of at most {MAX_EXPECTATIONS} entries is expected", shown(value))
            return []
        blocks = []
        for i, entry in enumerate(value):
            block, wrong_fields = self.block(ExpectBlock, entry, ("expect", i), {})
            if block is not None:
                self.problems += expect_problems(block, wrong_fields, ("expect", i))
                blocks.append(block)
        return blocks

    def derive(
        self, typed: Plant | TypedDynamics, run: SimulationPlan | None
    ) -> tuple[Plant, SimulationPlan | None, Coordinates | None]:
        """The plant that families see, the simulation in its coordinates, and the way back."""
        if isinstance(typed, Plant):
            return typed, run, None
        from cdobs_cli.coordinates import derive

        try:
            plant, coordinates = derive(typed)
            return plant, run if run is None or coordinates is None else coordinates.plan(run), coordinates
        except SpecError as error:
            self.problems += error.problems
            raise self.fail() from None


# Keys in another block than theirs, where they are told: (block, key, block it belongs to).
_MISPLACED = (
    ("plant", "C", "measurement"), ("measurement", "output", "plant"), ("plant", "initial_state", "simulation"),
    ("", "sampling", "measurement"),
)  # fmt: skip


def _told_there(root: dict[str, Any], block: str) -> set[str]:
    """Keys of a block that were typed in another: they are not missing."""
    holders = {"": root} | {name: one for name, one in root.items() if isinstance(one, dict)}
    return {key for holder, key, home in _MISPLACED if home == block and key in holders.get(holder, {})}


def _names(typed: Any, kind: type[list[Any]] | type[dict[str, Any]]) -> tuple[str, ...] | None:
    """Names as they are typed; None where one of them cannot be used in an expression."""
    if not isinstance(typed, kind) or len(typed) > MAX_STATES:
        return None
    names = tuple(typed)
    return names if all(isinstance(name, str) and is_identifier(name) for name in names) else None


def _outputs(plant: PlantBlock | None, measurement: MeasurementBlock | None) -> int | None:
    if plant is not None and plant.output is not None:
        return len(plant.output)
    return None if measurement is None or measurement.C is None else measurement.C.shape[0]
