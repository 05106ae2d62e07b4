"""The command line by subprocess: exit codes, streams, what is loaded, what is left behind."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from command import ROOT, Cdobs

from cdobs_cli.store import sealed

HEAVY = ("numpy", "scipy", "cvxpy", "clarabel", "matplotlib", "sympy", "flint", "pydantic", "yaml")


def loaded(tmp_path: Path, *arguments: str) -> set[str]:
    """Top-level packages that a command loads."""
    code = (
        "import sys\n"
        "names = lambda: sorted({m.partition('.')[0] for m in sys.modules})\n"
        "from cdobs_cli.__main__ import main\n"
        f"sys.argv = ['cdobs', *{list(arguments)!r}]\n"
        "try:\n"
        "    main()\n"
        "finally:\n"
        "    print('LOADED ' + ' '.join(names()), file=sys.stderr)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    lines = [line for line in done.stderr.splitlines() if line.startswith("LOADED ")]
    assert lines, done.stderr
    return set(lines[-1].split())


def test_help_and_version_load_nothing_heavy(tmp_path: Path) -> None:
    assert not loaded(tmp_path, "--help") & set(HEAVY)
    # typer itself loads pydantic to read the options of a command.
    assert not loaded(tmp_path, "run", "--help") & (set(HEAVY) - {"pydantic"})
    assert not loaded(tmp_path, "--version") & set(HEAVY)


def test_validate_loads_no_linear_algebra(tmp_path: Path, pendulum: str) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    assert not loaded(tmp_path, "validate", "p.yaml") & {"numpy", "scipy", "cvxpy", "clarabel", "matplotlib", "sympy"}


def test_check_of_a_stored_design_loads_no_solver(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    assert cdobs("synthesize", "p.yaml").returncode == 0
    assert not loaded(tmp_path, "check", "p.yaml") & {"cvxpy", "clarabel", "matplotlib", "sympy"}


def test_a_check_loads_what_its_design_names(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    assert cdobs("synthesize", "p.yaml").returncode == 0
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from cdobs_cli.batch import Settings, run\n"
        "from cdobs_cli.outcome import Job\n"
        "print(run(Job(Path('p.yaml'), Path('results/p')), ('check',), Settings()).status)\n"
        "print(*sys.modules)\n"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=tmp_path, env=os.environ | {"PYTHONPATH": str(ROOT)}, capture_output=True,
        text=True, check=True,
    )  # fmt: skip
    status, modules = done.stdout.splitlines()
    assert status == "ok"
    room, seen = "cdobs_cli.certify.methods.", modules.split()
    assert not {"scipy", "clarabel", "matplotlib"} & {name.partition(".")[0] for name in seen}
    assert {name.removeprefix(room).partition(".")[0] for name in seen if name.startswith(room)} <= {
        "base", "clock", "counterexample", "dead_beat", "named", "planar", "on_change", "spectral", "rung", "polygon",
    }  # fmt: skip
    assert "cdobs_cli.families.interval" not in seen and "cdobs_cli.choice" not in seen


def test_a_good_spec_end_to_end(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    done = cdobs("run", "p.yaml")
    assert done.returncode == 0, done.stderr
    assert done.stderr == ""
    assert "proved" in done.stdout
    folder = tmp_path / "results" / "p"
    names = {path.name for path in folder.iterdir()}
    assert {
        "design.json",
        "check.json",
        "simulation.json",
        "simulation.npz",
        "report.md",
        "report.html",
        "figures",
    } <= names
    check = json.loads((folder / "check.json").read_text())
    assert check["verdict"] == "proved"
    assert float(check["bounds"]["period_max"]["proved"]) >= 0.6
    simulation = json.loads((folder / "simulation.json").read_text())
    assert simulation["overall"]["error_final"] < 1e-2


def test_a_second_run_redoes_nothing(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    cdobs("run", "p.yaml")
    folder = tmp_path / "results" / "p"
    before = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert cdobs("run", "p.yaml").returncode == 0
    assert {path: path.stat().st_mtime_ns for path in folder.rglob("*")} == before
    assert not loaded(tmp_path, "run", "p.yaml") & {"scipy", "cvxpy", "clarabel", "matplotlib", "sympy"}
    (tmp_path / "p.yaml").write_text(
        pendulum.replace("horizon: 6", "horizon: 3") + "expect:\n  - {quantity: verdict, equals: proved}\n"
    )
    assert cdobs("run", "p.yaml").returncode == 0
    after = {path: path.stat().st_mtime_ns for path in folder.rglob("*")}
    assert after[folder / "design.json"] == before[folder / "design.json"]
    assert after[folder / "check.json"] == before[folder / "check.json"]
    assert after[folder / "simulation.json"] != before[folder / "simulation.json"]
    assert cdobs("run", "p.yaml", "--force").returncode == 0
    assert (folder / "design.json").stat().st_mtime_ns != before[folder / "design.json"]


def test_one_flipped_digit_of_the_gain_loses_the_proof(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    assert cdobs("check", "p.yaml").returncode == 0
    path = tmp_path / "results" / "p" / "design.json"
    clean = path.read_text()
    design = json.loads(clean)
    design["gain"]["K"][1][0] = "4" + design["gain"]["K"][1][0][1:]
    # As it stands the digest of the content is wrong, and the design is made anew.
    path.write_text(json.dumps(design))
    assert cdobs("check", "p.yaml").returncode == 0
    assert path.read_text() == clean
    # With the digest made to fit it is another design, and has its own check.
    path.write_text(json.dumps(sealed(design)))
    done = cdobs("check", "p.yaml")
    assert done.returncode == 1
    assert json.loads((path.parent / "check.json").read_text())["verdict"] != "proved"


def test_a_mistake_is_told_with_its_place_and_nothing_is_lost(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    spec = tmp_path / "p.yaml"
    spec.write_text(pendulum)
    cdobs("check", "p.yaml")
    before = (tmp_path / "results" / "p" / "check.json").read_bytes()
    spec.write_text(pendulum.replace("states:", "sates:").replace("0.6", "-0.6"))
    done = cdobs("run", "p.yaml")
    assert done.returncode == 2
    assert "p.yaml:4:" in done.stderr
    assert "did you mean" in done.stderr
    assert "p.yaml:10:" in done.stderr
    assert "Traceback" not in done.stderr
    assert (tmp_path / "results" / "p" / "check.json").read_bytes() == before


@pytest.mark.parametrize(
    "arguments",
    [
        ("run",),
        ("frobnicate",),
        ("run", "missing.yaml"),
        ("run", "."),
        ("check", "p.yaml", "--effort", "9"),
        ("init", "reachabilty"),
    ],
)
def test_wrong_command_lines(cdobs: Cdobs, arguments: tuple[str, ...]) -> None:
    done = cdobs(*arguments)
    assert done.returncode == 2
    assert "Traceback" not in done.stderr
    assert done.stderr


def test_report_refuses_a_broken_chain(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    assert cdobs("report", "p.yaml").returncode == 2
    assert cdobs("check", "p.yaml").returncode == 0
    assert cdobs("report", "p.yaml").returncode == 0
    path = tmp_path / "results" / "p" / "design.json"
    path.write_text(path.read_text().replace('"1"', '"2"', 1))
    assert cdobs("report", "p.yaml").returncode == 2


def test_one_bad_spec_does_not_stop_the_others(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    folder = tmp_path / "specs" / "deeper"
    folder.mkdir(parents=True)
    (folder / "a.yaml").write_text(pendulum)
    (tmp_path / "specs" / "b.yaml").write_text(": :")
    (tmp_path / "specs" / "shared.plant.yaml").write_text("not a spec")
    done = cdobs("check", "specs", "--jobs", "2", "--format", "json")
    assert done.returncode == 2
    document = json.loads(done.stdout)
    assert [(Path(result["spec"]).name, result["status"]) for result in document["results"]] == [
        ("b.yaml", "invalid"),
        ("a.yaml", "ok"),
    ]
    assert document["exit_code"] == 2
    assert (tmp_path / "results" / "deeper" / "a" / "check.json").exists()


def test_time_limit_leaves_it_undecided(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    done = cdobs("run", "p.yaml", "--time-limit", "0.01")
    assert done.returncode == 1
    assert "undecided" in done.stderr


def test_an_unwritable_folder_is_a_failure_of_the_tool(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(pendulum)
    (tmp_path / "results").write_text("a file, not a folder")
    done = cdobs("check", "p.yaml")
    assert done.returncode == 3
    assert "cannot write" in done.stderr


def test_interrupt_leaves_nothing_half_written(tmp_path: Path, pendulum: str) -> None:
    for number in range(8):
        (tmp_path / f"p{number}.yaml").write_text(pendulum)
    process = subprocess.Popen(
        [sys.executable, "-m", "cdobs_cli", "run", "."],
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        stderr=subprocess.PIPE,
        text=True,
        # Started in the background of a shell the tests inherit a SIGINT that is ignored.
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    deadline = time.monotonic() + 60
    while not list(tmp_path.glob("results/*/design.json")) and time.monotonic() < deadline:
        time.sleep(0.02)
    process.send_signal(signal.SIGINT)
    _, stderr = process.communicate(timeout=30)
    assert process.returncode == 3
    assert "interrupted" in stderr
    assert "Traceback" not in stderr
    for path in (tmp_path / "results").rglob("*.json"):
        json.loads(path.read_text())
    assert not [path for path in (tmp_path / "results").rglob(".*") if path.name != ".report.sha256"]


def test_a_counterexample_is_replayed(tmp_path: Path, pendulum: str, cdobs: Cdobs) -> None:
    (tmp_path / "p.yaml").write_text(
        pendulum.replace("  method: set\n", "  method: set\n  gain: {K: [[-1], [-1.8361]]}\n")
    )
    assert cdobs("check", "p.yaml").returncode == 1
    assert cdobs("simulate", "p.yaml", "--witness", "convergence").returncode == 0
    replay = json.loads((tmp_path / "results" / "p" / "witness_convergence_run.json").read_text())
    check = json.loads((tmp_path / "results" / "p" / "check.json").read_text())
    witness = next(claim["witness"] for claim in check["claims"] if claim["id"] == "convergence")
    assert replay["multiplier_measured"] >= float(witness["multiplier"]) - 1e-9 > 1
    assert replay["error_final"] > 50 * replay["error_first"]
    assert (tmp_path / "results" / "p" / "figures" / "witness_convergence_run.svg").exists()
    wrong = cdobs("simulate", "p.yaml", "--witness", "nothing")
    assert wrong.returncode == 2
    assert "convergence" in wrong.stderr
