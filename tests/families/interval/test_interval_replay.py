"""A box of x(0) and a word of periods run again through the engine: the bound crosses where it was proved to."""

import json
from dataclasses import replace

import pytest
from interval_plants import box, plant, scalar, up_to

from cdobs_cli.certificate import Witness
from cdobs_cli.errors import UsageError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.families.interval import Gain, Interval
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.archive import packed
from cdobs_cli.simulate.box import replay_box

LAGGING = Interval(gain=Gain(S=[[1, 0], [1, 1]], L=[[2], [-2]]))
FLOW, C = [["1.5", "1.5"], ["-1.6", "-1.6"]], [["1", "0"]]


def refuted(family, at):
    design = family.synthesize(at, 0)
    witness = family.certify(at, design, 0).claim("positivity").witness
    assert witness.kind == "box"
    written = json.dumps(witness.document())
    return HybridSystem(at, family.observer(at, design)), Witness.from_document(json.loads(written))


DRIVEN = {"noise": box(["-0.1"], ["0.3"]), "disturbance": box(["-0.01", "0"], ["0", "0.02"])}


@pytest.mark.parametrize(
    ("family", "at"),
    [
        (LAGGING, plant(FLOW, C, up_to("0.96"))),
        (LAGGING, plant(FLOW, C, up_to("0.7"), **DRIVEN)),
        (Interval(gain=Gain(S=[[1]], L=[["1.4"]])), scalar(SamplingLaw.periodic(Exact("log(3.6)")))),
    ],
)
def test_a_box_runs_again_until_its_bound_crosses(family, at):
    system, witness = refuted(family, at)
    run = replay_box(system, at.sampling, witness)
    document = run.document()
    size = max(abs(float(Exact(text))) for text in (*witness.data["lower"], *witness.data["upper"], "1"))
    assert document["inclusion_margin"] < 0
    assert abs(document["inclusion_margin"] - float(document["distance_proved"])) < 1e-6 * size
    assert document["samples"] >= len(witness.times) + 1
    arrays = run.arrays()
    assert arrays["x"].shape == arrays["x_lower"].shape == arrays["x_upper"].shape == (len(arrays["t"]), at.n)
    assert packed(run.arrays()) == packed(run.arrays())


def test_what_cannot_be_run_is_told():
    system, witness = refuted(LAGGING, plant(FLOW, C, up_to("0.96")))
    with pytest.raises(UsageError, match="no box"):
        replay_box(system, up_to("0.96"), replace(witness, kind="point"))
    for changes in ({"after": "x"}, {"state": 3}, {"lower": ["a", "b"]}, None):
        data = {} if changes is None else {**witness.data, **changes}
        with pytest.raises(UsageError, match="cannot be read"):
            replay_box(system, up_to("0.96"), replace(witness, data=data))


SPEC = """\
spec_version: 1
plant:
  states: [x]
  A: [[-1]]
  phi: ["0"]
  lipschitz: [[0]]
measurement:
  C: [[1]]
  sampling: {period: 1}
observer:
  family: interval
  gain: {S: [[1]], L: [[10]]}
simulation:
  horizon: 5
  initial_state: [0.5]
  initial_box: {lower: [0], upper: [1]}
"""


def test_the_command_writes_the_run_and_its_figure(tmp_path, cdobs):
    (tmp_path / "p.yaml").write_text(SPEC)
    done = cdobs("simulate", "p.yaml", "--witness", "positivity")
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "results" / "p"
    assert json.loads((folder / "witness_positivity_run.json").read_text())["inclusion_margin"] < 0
    assert (folder / "witness_positivity_run.npz").is_file()
    assert (folder / "figures" / "witness_positivity_run.svg").is_file()
    assert cdobs("report", "p.yaml").returncode in (0, 1)
    assert "A box of x(0) and a word of sampling periods" in (folder / "report.md").read_text()
