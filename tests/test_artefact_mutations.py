"""Random edits of every artefact: none may leave a verdict, a bound or a figure that a clean run does not give.

`CDOBS_MUTATIONS=1200 python -m pytest tests/test_artefact_mutations.py -n0` makes that many edits; a run of the
suite makes fewer. Each edit is drawn from a seed of its own, so that one that is believed can be made again.
"""

from __future__ import annotations

import copy
import io
import json
import os
import random
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import ROOT

from cdobs_cli import pipeline
from cdobs_cli.certificate import Check
from cdobs_cli.design import Design
from cdobs_cli.errors import ArtefactError
from cdobs_cli.run import Run
from cdobs_cli.simulate.archive import to_bytes
from cdobs_cli.spec.model import load
from cdobs_cli.store import ARTEFACTS, Store, sealed

SPECS = (
    "interval_pendulum", "interval_scalar", "interval_scalar_best",
    "lpv_zoh_duffing", "lpv_zoh_flexible_joint_auto", "lpv_zoh_sine", "plant_crane_messages",
    "reachability_chain3", "reachability_feedforward", "reachability_pendulum_printed_set",
    "updated_sampling_theorem_2", "updated_sampling_unstable", "updated_sampling_unstable_best",
    "updated_sampling_unstable_carried",
)  # fmt: skip
EDITS = int(os.environ.get("CDOBS_MUTATIONS", "180"))
AS_IT_IS = 15  # of so many edits one is followed by the real work, and not by what the clean run made
STAGES = (pipeline.synthesize, pipeline.check, pipeline.simulate)


@dataclass(frozen=True)
class Clean:
    """A clean run: what it made, and its files."""

    name: str
    design: Design
    check: Check
    run: Run
    files: dict[str, bytes]

    def work(self, folder: Path) -> pipeline.Work:
        """The spec once more, in a folder with the clean files."""
        folder.mkdir(exist_ok=True)
        for name, content in self.files.items():
            (folder / name).write_bytes(content)
        return pipeline.Work(spec(self.name), Store(folder), effort=0)


@cache
def spec(name: str) -> Any:
    return load(ROOT / "specs" / f"{name}.yaml")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mutations")


@pytest.fixture(scope="module", autouse=True)
def without_pictures() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("cdobs_cli.report.drawings.Drawings.drawn", lambda *_: ({}, {}))
        patch.setattr("cdobs_cli.report.files.render", lambda *_: {"report.md": b"", "report.html": b""})
        yield


_CLEAN: dict[str, Clean] = {}


def clean(name: str, folder: Path) -> Clean:
    if name not in _CLEAN:
        work = pipeline.Work(spec(name), Store(folder / name), effort=0)
        for stage in STAGES:
            stage(work)
        assert work.design is not None and work.check is not None and work.run is not None
        files = {artefact: (folder / name / artefact).read_bytes() for artefact in ARTEFACTS}
        _CLEAN[name] = Clean(name, work.design, work.check, work.run, files)
    return _CLEAN[name]


# ---------------------------------------------------------------- edits


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of every value of a document but the document itself."""
    inside = value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ()
    for key, inner in inside:
        yield (*path, key)
        yield from places(inner, (*path, key))


def changed(value: Any, draw: random.Random) -> Any:
    """Another value of the same type, one that a careless or a hostile editor would take."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return draw.choice([value + 1, -value - 1, 0.5 * value + 0.1, 999, 10**30])
    if isinstance(value, str):
        words = [
            word
            for word in ("proved", "refuted", "undecided", "found", "given", "none", "999", "-1", "inf", "", "\ud800")
            if word != value
        ]
        digits = [k for k, character in enumerate(value) if character.isdigit()]
        if digits and draw.random() < 0.7:
            k = draw.choice(digits)
            return value[:k] + str((int(value[k]) + draw.randint(1, 9)) % 10) + value[k + 1 :]
        return draw.choice(words)
    if isinstance(value, list):
        return draw.choice(
            [[], [*value, *value], value[:-1] if value else [None], value[::-1] if value != value[::-1] else [0]]
        )
    if isinstance(value, dict):
        return {} if value else {"a": 1}
    return draw.choice([0, "proved", [], {}])


def retyped(value: Any, draw: random.Random) -> Any:
    others = [None, True, 1, 1.0, "1", str(value), [value], {"value": value}, [], 10**400, float("nan")]
    return draw.choice([other for other in others if type(other) is not type(value) or other != value])


def edited_document(document: dict[str, Any], draw: random.Random) -> dict[str, Any]:
    edited = copy.deepcopy(document)
    *parents, last = draw.choice(list(places(edited)))
    holder: Any = edited
    for key in parents:
        holder = holder[key]
    kind = draw.choice(["changed", "changed", "changed", "retyped", "deleted", "added"])
    if kind == "deleted":
        del holder[last]
    elif kind == "added" and isinstance(holder, dict):
        holder[f"{last}_"] = holder[last]
    else:
        holder[last] = (retyped if kind == "retyped" else changed)(holder[last], draw)
    return edited


def edited_bytes(content: bytes, draw: random.Random) -> bytes:
    kind = draw.choice(["bit", "bit", "cut", "appended", "zeros", "emptied", "twice"])
    place = draw.randrange(len(content))
    if kind == "bit":
        return content[:place] + bytes([content[place] ^ (1 << draw.randrange(8))]) + content[place + 1 :]
    if kind == "zeros":
        return content[:place] + bytes(len(content[place : place + 40])) + content[place + 40 :]
    return {"cut": content[:place], "appended": content + b"\xff", "emptied": b"", "twice": content * 2}[kind]


def edited_archive(content: bytes, draw: random.Random) -> bytes:
    with np.load(io.BytesIO(content)) as archive:
        arrays = dict(archive)
    name = draw.choice(sorted(arrays))
    kind = draw.choice(["value", "shorter", "gone", "type", "pickled"])
    if kind == "gone":
        del arrays[name]
    elif kind == "shorter":
        arrays[name] = arrays[name][:-1]
    elif kind == "type":
        arrays[name] = arrays[name].astype("<U8")
    elif kind == "pickled":
        arrays[name] = arrays[name].astype(object)
    else:
        flat = arrays[name].reshape(-1)
        flat[draw.randrange(len(flat))] = 7
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def edit(name: str, content: bytes, draw: random.Random) -> bytes:
    if draw.random() < 0.3:
        return edited_bytes(content, draw)
    if name.endswith(".npz"):
        return edited_archive(content, draw)
    return json.dumps(edited_document(json.loads(content), draw), indent=1).encode()


def same(one: bytes, other: bytes) -> bool:
    """Whether two JSON texts hold the same: an edit of white space is none."""
    try:
        values = [json.dumps(json.loads(content, object_pairs_hook=list), sort_keys=True) for content in (one, other)]
    except (ValueError, RecursionError):
        return False
    return values[0] == values[1]


# ---------------------------------------------------------------- what follows an edit


def remade(patch: pytest.MonkeyPatch, whole: Clean) -> None:
    """What would be made of the spec, of the clean design, or of no other, is what the clean run made."""

    def of_clean(made: Any) -> Callable[..., Any]:
        def verb(work: pipeline.Work, design: Design) -> Any:
            assert design.document() == whole.design.document(), "an edited design is about to be used"
            return made

        return verb

    patch.setattr(pipeline, "new_design", lambda *_: whole.design)
    patch.setattr(pipeline, "_certify", of_clean(whole.check))
    patch.setattr(pipeline, "_new_run", of_clean(whole.run))


def believed(whole: Clean, folder: Path, artefact: str, content: bytes) -> str | None:
    """What is wrong after an edit; None where report refuses it, and the work done again is that of the clean run."""
    whole.work(folder)
    (folder / artefact).write_bytes(content)
    shown = pipeline.Work(spec(whole.name), Store(folder), effort=0)
    try:
        pipeline.report(shown)
    except ArtefactError as error:
        if "edited or damaged" not in str(error) and "not of one run" not in str(error):
            return f"report says something else: {error}"
    else:
        return "report shows it"
    again = pipeline.Work(spec(whole.name), Store(folder), effort=0)
    for stage in STAGES:
        stage(again)
    for name, first in whole.files.items():
        if (folder / name).read_bytes() != first:
            return f"{name} is not that of a clean run"
    return None


@pytest.mark.parametrize("name", SPECS)
def test_no_edit_is_believed(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    whole = clean(name, folder)
    failures, edits, seed = [], 0, 0
    while edits < EDITS // len(SPECS):
        seed += 1
        draw = random.Random(f"{name} {seed}")
        artefact = draw.choice(ARTEFACTS)
        content = edit(artefact, whole.files[artefact], draw)
        if content == whole.files[artefact] or (artefact.endswith(".json") and same(content, whole.files[artefact])):
            continue
        edits += 1
        with monkeypatch.context() as patch:
            if edits % AS_IT_IS:
                remade(patch, whole)
            found = believed(whole, folder / "edited", artefact, content)
        if found:
            failures.append(f"{name} {seed} {artefact}: {found}")
    assert not failures, "\n".join(failures)


def test_equal_runs_are_byte_equal(folder: Path) -> None:
    for name in ("interval_scalar_best", "reachability_chain3"):
        again = pipeline.Work(
            spec(name), Store(folder / "again"), effort=0, forced=frozenset(("synthesize", "check", "simulate"))
        )
        for stage in STAGES:
            stage(again)
        assert {artefact: (folder / "again" / artefact).read_bytes() for artefact in ARTEFACTS} == clean(
            name, folder
        ).files


# ---------------------------------------------------------------- edits whose digest was made to fit


def resealed(whole: Clean, folder: Path, artefact: str, change: Callable[[dict[str, Any]], None]) -> pipeline.Work:
    """The work on a folder in which an artefact was changed, its own digest with it."""
    work = whole.work(folder)
    document = json.loads(whole.files[artefact])
    change(document)
    (folder / artefact).write_text(json.dumps(sealed(document)))
    return work


def done(work: pipeline.Work) -> dict[str, Any]:
    for stage in STAGES:
        stage(work)
    return pipeline.documents(work)


def put(*path: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        for key in path[:-1]:
            document = document[key]
        if value is None:
            del document[path[-1]]
        else:
            document[path[-1]] = value

    return change


GIVEN = {
    "reachability_pendulum_set": {"K": None},
    "reachability_pendulum_printed": {"K": [["-1"], ["-1.8361"]]},
    "lpv_zoh_duffing": {"L": None},
    "lpv_zoh_sine": {"L": [["8.7188"], ["7.0571"]]},
    "interval_scalar_best": {"S": None, "L": None, "K_lower": None, "K_upper": None},
    "interval_scalar": {"S": [["1"]], "L": [["1.4"]], "K_lower": [["-3"]], "K_upper": [["-3"]]},
    "updated_sampling_unstable_best": {"K": None, "alpha": None, "a1": None, "a2": None, "a3": None},
    "updated_sampling_unstable_carried": {},
    "updated_sampling_unstable": {
        "K": [["-0.8333"], ["-0.1852"]], "alpha": [["0.9"]], "a1": [["0.3333"]], "a2": [["0.3"]], "a3": [["0"]],
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("name", "artefact", "change"),
    [
        ("interval_scalar", "design.json", put("gain", "L", value=[["0.5"]])),
        ("interval_scalar", "design.json", put("gain", "S", value=[["2"]])),
        ("interval_scalar", "design.json", put("outcome", value="found")),
        ("interval_pendulum", "design.json", put("gain", "K_lower", value=None)),
        ("interval_scalar_best", "design.json", put("gain", "K_upper", value=None)),
        ("reachability_chain3", "design.json", put("gain", "L", value=[["1"]])),
        ("lpv_zoh_sine", "design.json", put("gain", "L", value=[["1.2"], ["0.5"]])),
        ("updated_sampling_unstable", "design.json", put("gain", "a2", value=[["-1"]])),
        ("updated_sampling_unstable", "design.json", put("gain", "alpha", value=[["0.01"]])),
        ("lpv_zoh_flexible_joint_auto", "design.json", put("slopes", value={})),
        ("lpv_zoh_flexible_joint_auto", "design.json", put("sampling", value={"period": "1e-9"})),
        ("lpv_zoh_duffing", "design.json", put("gain", value={})),
        ("lpv_zoh_duffing", "design.json", put("gain", "L", value=[["1"]])),
        ("reachability_chain3", "design.json", put("estimate", "way", value="cut")),
        ("reachability_chain3", "design.json", put("estimate", "way", value="shut")),
        ("updated_sampling_unstable", "design.json", put("estimate", "way", value="continuation")),
        ("updated_sampling_unstable_carried", "design.json", put("details", "law", "T_min", value="0.1")),
        ("updated_sampling_unstable_carried", "design.json", put("details", "law", "reset", value=True)),
        ("updated_sampling_unstable_carried", "design.json", put("details", "law", "kappa", value="1")),
        ("updated_sampling_unstable_carried", "design.json", put("details", "law", "sigma", value="-1")),
        ("updated_sampling_unstable_carried", "design.json", put("details", "law", "F", value=[["1"]])),
        ("updated_sampling_unstable_carried", "design.json", put("details", "law", value={})),
        ("updated_sampling_unstable_carried", "design.json", put("outcome", value="given")),
        ("reachability_chain3", "design.json", put("schema_version", value=True)),
        ("reachability_chain3", "design.json", put("digests", "more", value="a")),
        ("reachability_chain3", "check.json", put("verdict", value="undecided")),
        ("reachability_chain3", "check.json", put("claims", value=[])),
        ("reachability_chain3", "check.json", lambda check: check.update(verdict="undecided", claims=[])),
        ("reachability_chain3", "check.json", put("claims", 0, "required", value=1)),
        ("reachability_chain3", "check.json", put("bounds", "period_max", "proved", value="much")),
        ("reachability_chain3", "check.json", put("digests", "design", value="0" * 64)),
        ("interval_scalar", "check.json", put("claims", value="none")),
        ("reachability_chain3", "simulation.json", put("overall", "diverged", value=True)),
        ("reachability_chain3", "simulation.json", put("runs", 0, "error_final", value=0.0)),
        ("reachability_chain3", "simulation.json", put("runs", value=[])),
        ("reachability_chain3", "simulation.json", put("digests", "archive", value="0" * 64)),
        ("interval_scalar_best", "simulation.json", put("overall", "inclusion_margin", value=1e9)),
    ],
)  # fmt: skip
def test_what_can_be_seen_is_not_believed_under_a_digest_that_fits(
    name: str, artefact: str, change: Callable[[dict[str, Any]], None], folder: Path
) -> None:
    whole = clean(name, folder)
    with pytest.raises(ArtefactError):
        pipeline.report(resealed(whole, folder / "edited", artefact, change))
    done(resealed(whole, folder / "edited", artefact, change))
    assert {one: (folder / "edited" / one).read_bytes() for one in ARTEFACTS} == whole.files


def test_every_family_says_what_the_spec_gives() -> None:
    given = {name: {k: v and v.texts() for k, v in spec(name).observer.given().items()} for name in GIVEN}
    assert given == GIVEN


def test_numbers_in_details_and_gain_bear_no_bound_by_themselves(folder: Path) -> None:
    whole = clean("updated_sampling_unstable_best", folder)
    smaller = done(resealed(whole, folder / "edited", "design.json", put("details", "rate", "largest", value="0.001")))[
        "check"
    ]
    assert smaller["verdict"] == "undecided"
    assert not smaller["bounds"]
    falling = done(resealed(whole, folder / "edited", "design.json", put("gain", "a2", value=[["-1"]])))["check"]
    assert falling["verdict"] != "proved"
    assert not any(
        name.startswith("guaranteed_period") and name != "guaranteed_period.constant" for name in falling["bounds"]
    )


HULL = """\
spec_version: 1
plant:
  states: [x]
  A: [[0.5]]
  phi: ["0"]
  lipschitz: [[0]]
measurement:
  C: [[1]]
  sampling: {min_period: 0.1, max_period: 0.3}
observer:
  family: interval
  tighten: hull
  gain: {S: [[1]], L: [[2]]}
"""


def test_the_longest_period_of_another_law_is_not_that_of_this_one(tmp_path: Path) -> None:
    (tmp_path / "hull.yaml").write_text(HULL)
    hull = load(tmp_path / "hull.yaml")
    first = pipeline.Work(hull, Store(tmp_path / "results"), effort=0)
    bound = pipeline.check(first).bounds["period_max"].proved
    assert bound is not None and float(bound) > 0.3
    path = tmp_path / "results" / "design.json"
    document = json.loads(path.read_text())
    hulls = [one for one in document["certificates"] if one["method"] == "hull"]
    frontier = max(hulls, key=lambda one: float(one["sampling"]["max_period"]))
    for law in ({"period": bound}, {"min_period": "0.2", "max_period": bound}):
        frontier["sampling"] = law
        path.write_text(json.dumps(sealed(document)))
        again = pipeline.check(pipeline.Work(hull, Store(tmp_path / "results"), effort=0)).bounds["period_max"].proved
        assert again is None or float(again) <= 0.3


def test_a_run_with_other_trajectories_than_it_tells_of(folder: Path) -> None:
    """Both files edited, every digest made to fit: the figures are those of the trajectories, or all is made anew."""
    import hashlib
    from dataclasses import replace

    whole = clean("reachability_chain3", folder)
    one = whole.run.trajectories[0]
    for trajectory in (
        replace(one, x=one.x * 2),
        replace(one, x=one.x[:, :2]),
        replace(one, estimates={"x_lower": one.x}),
    ):
        work = whole.work(folder / "edited")
        archive = to_bytes(replace(whole.run, trajectories=(trajectory,)))
        (folder / "edited" / "simulation.npz").write_bytes(archive)
        document = json.loads(whole.files["simulation.json"])
        document["digests"]["archive"] = hashlib.sha256(archive).hexdigest()
        (folder / "edited" / "simulation.json").write_text(json.dumps(sealed(document)))
        done(work)
        assert (folder / "edited" / "simulation.npz").read_bytes() == whole.files["simulation.npz"]


@pytest.mark.parametrize("name", SPECS[:: 1 if EDITS > 999 else 4])
def test_no_edit_with_a_digest_that_fits_breaks_the_tool(name: str, folder: Path) -> None:
    """Whatever stands there: no crash, and proved only what the proofs prove."""
    whole = clean(name, folder)
    for seed in range(max(6, EDITS // 40)):
        draw = random.Random(f"resealed {name} {seed}")
        artefact = draw.choice(["design.json", "check.json", "simulation.json"])
        document = edited_document(json.loads(whole.files[artefact]), draw)
        if not isinstance(document.get("digests"), dict):
            continue
        try:
            content = json.dumps(sealed(document))
        except ValueError:
            continue
        for verbs in ((pipeline.report,), (*STAGES, pipeline.report)):
            work = whole.work(folder / "edited")
            (folder / "edited" / artefact).write_text(content)
            try:
                for verb in verbs:
                    verb(work)
            except ArtefactError:
                assert verbs == (pipeline.report,), f"{name} {seed} {artefact}"


def test_an_archive_is_a_zip_whose_members_are_whole(folder: Path) -> None:
    """The edits above are of what is there: this is it."""
    with zipfile.ZipFile(io.BytesIO(clean("reachability_chain3", folder).files["simulation.npz"])) as archive:
        assert archive.testzip() is None
        assert {"t.npy", "x.npy", "x_hat.npy", "t_k.npy", "y_k.npy"} <= set(archive.namelist())
