"""What is compared: specs of one plant as they are typed, the families that take it, and a placed gain."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Literal, get_args

from cdobs_cli.arrays import Array
from cdobs_cli.baselines.constant_gain import placed_gain
from cdobs_cli.baselines.poles import linearised
from cdobs_cli.errors import SpecError, UsageError
from cdobs_cli.families import FAMILIES
from cdobs_cli.records import dataclass
from cdobs_cli.spec.auto_block import AutoBlock, Choice
from cdobs_cli.spec.model import Spec, load_document, with_files
from cdobs_cli.spec.reader import Document, read
from cdobs_cli.spec.replaced import Setting, replaced
from cdobs_cli.store import digest
from cdobs_cli.sweep.points import Point

Kind = Literal["spec", "family", "constant gain"]
# Where the poles of the linear part's sampled error are placed: it halves from sample to sample.
POLES = 0.5
_PLACED_IN = "reachability"  # the family whose K is this gain


@dataclass(frozen=True)
class Entry:
    """One observer: its name in the table, what it is, the spec it comes from (from 0), and its point."""

    name: str
    kind: Kind
    place: int
    point: Point


@dataclass(frozen=True)
class Compared:
    """The specs, what is compared, and in sentences what is not and why."""

    specs: tuple[Spec, ...]
    entries: tuple[Entry, ...]
    notes: tuple[str, ...]

    @property
    def states(self) -> tuple[str, ...]:
        return self.specs[0].plant.states


def compared(paths: Sequence[Path], effort: int, top: Path) -> Compared:
    """Every observer once, whatever it is called: first the specs, then what else takes plant and law of each.

    Raises:
        SpecError: a spec is wrong.
        UsageError: the specs are of different plants.
    """
    read_in = [_read(path) for path in paths]
    first = read_in[0][1]
    for _, spec in read_in[1:]:
        if spec.normalised()["plant"] != first.normalised()["plant"]:
            raise UsageError(f"{spec.source_path}: its plant is not that of {first.source_path}; compare them apart")
    entries: list[Entry] = []
    notes: list[str] = []
    seen: set[str] = set()
    for place, (document, spec) in enumerate(read_in):
        if _observer_of(spec) not in seen:
            seen.add(_observer_of(spec))
            entries.append(Entry(spec.source_path.stem, "spec", place, Point.of(document, (), effort, top)))
    for place, (document, spec) in enumerate(read_in):
        which = f", {spec.source_path.stem}" if len(read_in) > 1 else ""
        for name, kind, setting in _further(spec, notes):
            settings = (setting, *_without_expect(document))
            try:
                other = _loaded(replaced(document, settings), spec.source_path)
            except SpecError as error:  # what the spec types of an input, say, that its own family drives
                problem = error.problems[0]
                notes.append(f"{name}{which} is left out: {problem.path}: {problem.what}.")
                continue
            if _observer_of(other) not in seen:
                seen.add(_observer_of(other))
                entries.append(Entry(f"{name}{which}", kind, place, Point.of(document, settings, effort, top)))
    return Compared(tuple(spec for _, spec in read_in), tuple(entries), tuple(dict.fromkeys(notes)))


def _read(path: Path) -> tuple[Document, Spec]:
    document = with_files(read(path), path)
    return document, _loaded(document, path)


def _loaded(document: Document, path: Path) -> Spec:
    return load_document(replaced(document, ()), path)  # of a copy


def _observer_of(spec: Spec) -> str:
    content = spec.normalised()
    return digest({name: content[name] for name in ("measurement", "observer", "simulation")})


def _without_expect(document: Document) -> tuple[Setting, ...]:
    """What a spec expects is expected of its own observer."""
    return (Setting("expect", "null"),) if document.root.get("expect") is not None else ()


def _further(spec: Spec, notes: list[str]) -> Iterator[tuple[str, Kind, Setting]]:
    """Name, kind and observer block of what else takes plant and law; why the rest does not goes to the notes."""
    choice = Choice.of(AutoBlock(), spec.plant, spec.simulation)
    asked = getattr(spec.observer, "objective", None) if spec.choice is None else spec.choice.block.objective
    for name in choice.cards:
        known = asked is not None and _takes_objective(name, asked)
        objective = f", objective: {asked}" if known else ""
        yield f"{name}, gain found", "family", Setting("observer", f"{{family: {name}{objective}}}")
    notes += [f"{name} is left out: {why}." for name, why in choice.refused.items()]
    try:
        K = _placed(spec)
        yield (
            "constant gain, placed",
            "constant gain",
            Setting("observer", f"{{family: {_PLACED_IN}, gain: {{K: {K}}}}}"),
        )
    except (ValueError, SpecError) as error:
        notes.append(f"No constant gain is placed: {error}.")


def _takes_objective(family: str, objective: str) -> bool:
    return objective in get_args(FAMILIES[family].model_fields["objective"].annotation)


def must_be_placed(spec: Spec) -> None:
    """Raises: ValueError where no gain is placed for this plant and law."""
    law = spec.plant.sampling
    if spec.plant.p != 1 or law.is_updated or law.is_on_change or law.has_sensors or spec.plant.delays:
        raise ValueError(
            "it is placed for one output, read without delay at instants that the observer does not choose"
        )


def linearised_at_start(spec: Spec) -> tuple[Array, Array]:
    """A and C of the plant where its runs begin to estimate. Raises: ValueError where it has no derivative there."""
    start = None if spec.simulation is None else spec.simulation.initial_estimate
    return linearised(spec.plant, [0.0] * spec.plant.n if start is None else [float(one) for one in start])


def _placed(spec: Spec) -> str:
    """Rows of K, for the largest period. Raises: ValueError where there is none."""
    must_be_placed(spec)
    K = placed_gain(*linearised_at_start(spec), float(spec.plant.sampling.period), POLES)
    return str(K.texts()).replace("'", '"')
