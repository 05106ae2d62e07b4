"""The proof and its checker: what holds is told again without the tool, and what was planted is refused."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from command import PENDULUM, ROOT, forked

from cdobs_cli.errors import UsageError
from cdobs_cli.export.about import About
from cdobs_cli.export.check_proof import RefusedError, check
from cdobs_cli.export.proof import proof_files
from cdobs_cli.spec.model import load
from cdobs_cli.synthesis import new_design, plant_of

CHECKER = ROOT / "cdobs_cli/export/check_proof.py"
GIVEN = PENDULUM.replace("  method: set\n", "  method: clock\n  gain: {K: [[1], [1.2]]}\n")
BOUNDED = "  noise: {lower: [-0.01], upper: [0.01]}\n"
SPECS = {
    "periodic": GIVEN,
    "aperiodic": GIVEN.replace("{period: 0.6}", "{min_period: 0.2, max_period: 0.6}"),
    "lossy": GIVEN.replace("{period: 0.6}", "{period: 0.3}\n  lost: {at_most: 1}"),
    "random": GIVEN.replace("{period: 0.6}", "{period: 0.3}\n  lost: {probability: 0.2}"),
    "from_zero": GIVEN.replace("reachability", "lpv_zoh").replace("{K: [[1], [1.2]]}", "{L: [[1.5], [1.5]]}")
    .replace("{period: 0.6}", "{max_period: 0.3}"),
    "white": GIVEN.replace("observer:", "  noise: {covariance: [[1e-4]]}\nobserver:"),
    "bounded": GIVEN.replace("observer:", f"{BOUNDED}observer:"),
}  # fmt: skip


@cache
def written(name: str) -> str:
    """The text of a proof."""
    with TemporaryDirectory() as folder:
        path = Path(folder) / "s.yaml"
        path.write_text(SPECS[name])
        spec = load(path)
        design = new_design(spec, 0)
        about = About(spec.title, "s.yaml", "proved", (), (), design.sampling.words, spec.labels)
        return proof_files(about, spec.observer, plant_of(spec, design), design)["proof/proof.json"]


def proof(name: str) -> Any:
    return json.loads(written(name))


@pytest.mark.parametrize(
    ("name", "told"),
    [
        ("periodic", "clock: the error decays;"), ("aperiodic", "samples 0.2 to 0.6 apart"),
        ("lossy", "at most 1 in a row lost"), ("random", "clock: the error decays in mean square;"),
        ("from_zero", "samples 0 to"), ("white", "mean_square: the root mean square of the error over time"),
        ("bounded", "peak: from a box of errors before the first sample, always"),
    ],
)  # fmt: skip
def test_what_holds_is_told(name: str, told: str) -> None:
    assert any(told in sentence for sentence in check(proof(name)))


def of(document: Any, method: str, number: int = 0) -> Any:
    """The data of a certificate."""
    return [one for one in document["certificates"] if one["method"] == method][number]


def scaled(holder: Any, key: Any, factor: Fraction | int | str) -> None:
    holder[key] = str(Fraction(holder[key]) * Fraction(factor))


def entry(rows: Any) -> Any:
    """Where the first number of nested lists stands."""
    while isinstance(rows[0], list):
        rows = rows[0]
    return rows


Fault = Callable[[Any], None]


def faults() -> Iterator[tuple[str, str, Fault]]:
    """Which proof, what is planted, and how."""
    for name in ("periodic", "aperiodic", "lossy", "from_zero", "white", "bounded"):
        method = {"white": "mean_square", "bounded": "peak"}.get(name, "clock")
        rows = (lambda one: one["data"]["chains"][0]["P"][0]) if method == "peak" else (lambda one: one["data"]["P"])
        yield name, "gain", lambda d: scaled(d["gain"][1], 0, 4)
        yield name, "gain turned", lambda d: scaled(d["gain"][0], 0, -1)
        yield (
            name,
            "slopes",
            lambda d: scaled(d["slopes"][0] if "slopes" in d else d["plant"]["slopes"][0], "upper", 60),
        )
        yield name, "plant", lambda d: scaled(d["plant"]["A"][0], 1, 30)
        yield name, "output", lambda d: scaled(d["plant"]["C"][0], 0, -1)
        yield name, "P negative", lambda d, m=method, r=rows: scaled(entry(r(of(d, m))[0]), 0, -1)
        yield name, "P lost", lambda d, m=method, r=rows: r(of(d, m)).pop()
        yield name, "not a fraction", lambda d, m=method, r=rows: entry(r(of(d, m))).__setitem__(0, "nan")
        yield name, "a float", lambda d, m=method, r=rows: entry(r(of(d, m))).__setitem__(0, 1.0)
        yield name, "another observer", lambda d: d.update(observer="filtered")
    yield "periodic", "period", lambda d: [scaled(of(d, "clock")["law"], end, 5) for end in ("T_min", "T_max")]
    yield "periodic", "law widened", lambda d: scaled(of(d, "clock")["law"], "T_max", "101/100")
    yield "periodic", "rate", lambda d: of(d, "clock")["data"].update(sigma="9")
    yield "periodic", "rate below 0", lambda d: of(d, "clock")["data"].update(sigma="-1")
    yield "periodic", "basis", lambda d: of(d, "clock")["data"].update(basis=[["1", "1"], ["1", "1"]])
    yield "periodic", "degrees", lambda d: of(d, "clock")["data"].update(degrees=[0, 4])
    yield "periodic", "pieces", lambda d: of(d, "clock")["data"].update(pieces=[0, 2])
    yield "periodic", "method", lambda d: of(d, "clock").update(method="belief")
    yield "periodic", "none", lambda d: d.update(certificates=[])
    yield "periodic", "version", lambda d: d.update(schema_version=2)
    yield "lossy", "more lost", lambda d: of(d, "clock")["law"].update(lost=2)
    yield "random", "likelier lost", lambda d: of(d, "clock")["law"].update(probability="4/5")
    yield "random", "certainly lost", lambda d: of(d, "clock")["law"].update(probability="1")
    yield "from_zero", "another kind", lambda d: d.update(observer="corrected")
    yield "aperiodic", "from earlier on", lambda d: scaled(of(d, "clock")["law"], "T_min", "1/50")
    yield "white", "bound", lambda d: scaled(of(d, "mean_square")["data"], "bound", "99/100")
    yield "white", "noise", lambda d: scaled(d["plant"]["covariance"][0], 0, "11/10")
    yield "white", "no noise is declared", lambda d: d["plant"].update(covariance=None)
    yield "bounded", "bound", lambda d: scaled(of(d, "peak")["data"], "bound", "99/100")
    yield "bounded", "noise", lambda d: scaled(d["plant"]["noise"], 0, "11/10")
    yield "bounded", "disturbance", lambda d: d["plant"].update(disturbance=["1/10", "1/10"])
    yield "bounded", "window", lambda d: of(d, "peak")["data"]["chains"][0].update(window=["1/100", "1"])
    yield "bounded", "rho", lambda d: of(d, "peak")["data"]["chains"][0].update(rho="1")
    yield "bounded", "prices", lambda d: scaled(of(d, "peak")["data"]["chains"][0]["nu"][0], 0, "1/2")
    yield "bounded", "wider start", lambda d: of(d, "peak")["data"].update(start=[["-9", "9"], ["-9", "9"]])
    yield "bounded", "state", lambda d: of(d, "peak")["data"].update(state=2)


FAULTS = list(faults())


@pytest.mark.parametrize(("name", "what", "plant"), FAULTS, ids=[f"{name}: {what}" for name, what, _ in FAULTS])
def test_planted_faults_are_found(name: str, what: str, plant: Fault) -> None:
    assert len(FAULTS) >= 50
    document = proof(name)
    before = copy.deepcopy(document)
    plant(document)
    assert document != before
    with pytest.raises(RefusedError):
        check(document)


def test_the_checker_stands_alone() -> None:
    text = CHECKER.read_text()
    imported = {line.split()[1].split(".")[0] for line in text.splitlines() if line.startswith(("import ", "from "))}
    assert imported <= set(sys.stdlib_module_names)
    assert sum(bool(line.strip()) for line in text.splitlines()) <= 400


@pytest.mark.parametrize(("spoilt", "code", "told"), [("", 0, "holds"), ("{", 1, "REFUSED"), ("[]", 1, "REFUSED")])
def test_it_runs_beside_its_proof(tmp_path: Path, spoilt: str, code: int, told: str) -> None:
    (tmp_path / "proof.json").write_text(spoilt or written("periodic"))
    (tmp_path / "check_proof.py").write_text(CHECKER.read_text())
    done = subprocess.run(
        [sys.executable, "-I", "-S", tmp_path / "check_proof.py"], capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stdout.split()[0]) == (code, told), done.stderr


def test_what_fractions_do_not_hold_is_told(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(GIVEN.replace("[[0, 1], [0, 0]]", '[[0, 1], [0, "-sqrt(2)/100"]]'))
    spec = load(path)
    design = new_design(spec, 0)
    about = About(spec.title, "s.yaml", "proved", (), (), design.sampling.words, spec.labels)
    with pytest.raises(UsageError, match="fractions only"):
        proof_files(about, spec.observer, plant_of(spec, design), design)


def test_of_late_samples_and_other_methods_no_proof_is_written() -> None:
    SPECS["late"] = GIVEN.replace("{period: 0.6}", "{period: 0.6}\n  delay: 0.1")
    SPECS["sampled"] = GIVEN.replace("method: clock", "method: set").replace("1.2", "1")
    with pytest.raises(UsageError, match="at once"):
        written("late")
    with pytest.raises(UsageError, match="certificates by set"):
        written("sampled")


def test_the_command_writes_both(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(GIVEN)
    assert forked(["check", "p.yaml", "--effort", "0"], tmp_path).returncode == 0
    done = forked(["export", "p.yaml", "--to", "proof", "--effort", "0"], tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "results/p/export/proof"
    assert {path.name for path in folder.iterdir()} == {"proof.json", "check_proof.py"}
    assert check(json.loads((folder / "proof.json").read_text()))
