"""The proof and its checker: what holds is told again without the tool, and what was planted is refused."""

from __future__ import annotations

import copy
import json
import subprocess
import sys
from collections.abc import Callable, Iterator
from fractions import Fraction
from functools import cache, reduce
from itertools import pairwise, product
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
from command import PENDULUM, ROOT, forked
from flint import arb
from scipy.linalg import expm

from cdobs_cli.errors import UsageError
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.export.about import About
from cdobs_cli.export.check_proof import Interval, Matrix, RefusedError, chain_box, check, series
from cdobs_cli.export.proof import proof_files
from cdobs_cli.families.reachability.canonical import LastRow, box_31, delta_star
from cdobs_cli.spec.model import load
from cdobs_cli.synthesis import new_design, plant_of

if TYPE_CHECKING:
    from numpy.typing import NDArray

CHECKER = ROOT / "cdobs_cli/export/check_proof.py"
GIVEN = PENDULUM.replace("  method: set\n", "  method: clock\n  gain: {K: [[1], [1.2]]}\n")
SET = PENDULUM.replace("  method: set\n", "  method: set\n  gain: {K: [[1], [1.2]]}\n")
CHAIN = """\
  states: [x, v, a]
  A: [[0, 1, 0], [0, 0, 1], [0, 0, 0]]
  phi: ["0", "0", "sin(x) - v"]
  lipschitz: [[0, 0, 0], [0, 0, 0], [[-1, 1], [-1, -1], 0]]
"""
FEEDFORWARD = """\
  states: [x, v, a]
  A: [[0, 1, 0.3], [0, 0, -1], [0, 0, 0]]
  phi: ["sin(x)", "0", "0"]
  lipschitz: [[1, 0, 0], [0, 0, 0], [0, 0, 0]]
"""
LINEAR = """\
  states: [x, v]
  A: [[0, 1], [-2, -3]]
  phi: ["0", "0"]
  lipschitz: [[0, 0], [0, 0]]
"""


def of_plant(plant: str, gain: str) -> str:
    """A spec with method set."""
    head, rest = SET.split("  states:")
    text = f"{head}{plant}measurement:{rest.split('measurement:')[1]}".replace("[[1], [1.2]]", gain)
    for two, three in (("[[1, 0]]", "[[1, 0, 0]]"), (": [1, 0]", ": [1, 0, 0]"), (": [0, 0]", ": [0, 0, 0]")):
        text = text.replace(two, three) if "[x, v, a]" in text else text
    return text


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
    "set": SET,
    "set_full": SET.replace("[[1], [1.2]]", "[[0.97], [1.2]]"),
    "set_chain": of_plant(CHAIN, "[[1], [2.1], [1.6]]"),
    "set_feedforward": of_plant(FEEDFORWARD, "[[0.977], [0.707], [-0.106]]").replace("period: 0.6", "period: 1"),
    "set_linear": of_plant(LINEAR, "[[0.5], [0.3]]"),
    "linear": of_plant(LINEAR, "[[0.5], [0.3]]").replace("method: set", "method: clock"),
    "linear_held": of_plant(LINEAR, "[[0.5], [0.3]]").replace("reachability\n  method: set", "lpv_zoh")
    .replace("{K:", "{L:"),
    "set_noisy": SET.replace("observer:", f"{BOUNDED}observer:"),
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
        ("set", "samples 0.6 to 0.6 apart"), ("set_full", "set: the error decays"),
        ("set_chain", "set: the error decays"),
        ("set_feedforward", "set: the error decays"), ("set_linear", "set: the error decays"),
        ("set_noisy", "set: the error decays"), ("linear", "set: the error decays"),
        ("linear_held", "set: the error decays"),
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


def sets() -> Iterator[tuple[str, str, Fault]]:
    """Faults about certificates of sets, the first of each proof."""

    def law(**ends: Any) -> Fault:
        return lambda d: of(d, "set")["law"].update(ends)

    def data(**changed: Any) -> Fault:
        return lambda d: of(d, "set")["data"].update(changed)

    def slope(**ends: Any) -> Fault:
        return lambda d: d["plant"]["slopes"][0].update(ends)

    def plant(**changed: Any) -> Fault:
        return lambda d: d["plant"].update(changed)

    zeros = [["0", "0"], ["0", "0"]]
    for name in ("set", "set_full", "set_chain", "set_feedforward", "set_linear"):
        another = "1/100" if name == "set_linear" else "7/2"  # each longer period serves that plant
        yield name, "another period", law(T_min=another, T_max=another)
        yield name, "a range of periods", law(T_min="1/2")
        yield name, "gain without its maps", lambda d: scaled(d["gain"][1], 0, "101/100")
        yield name, "output", lambda d: scaled(d["plant"]["C"][0], 0, 2)
        yield name, "faster fall", lambda d: scaled(of(d, "set")["data"], "rho_squared", "1/9")
        yield name, "no fall", data(rho_squared="1")
        yield name, "form turned", lambda d: scaled(of(d, "set")["data"]["Q"][0], 0, -1)
        yield name, "form of full rows", lambda d: of(d, "set")["data"]["Q"][-1].append("0")
        yield name, "no form", data(Q=[])
        yield name, "map lost", lambda d: of(d, "set")["data"]["T"].pop()
        yield name, "another basis", lambda d: of(d, "set")["data"]["S"].reverse()
        yield name, "steps below 0", data(steps=-1)
        yield name, "steps without end", data(steps=10**9)
        yield name, "another kind", lambda d: d.update(observer="held")
        yield name, "outputs that vary", plant(outputs=[{"part": [["1", "0", "0"]], "lower": "-1", "upper": "1"}])
    for name in ("set", "set_full"):
        yield name, "period beyond the chain's", law(T_min="158/100", T_max="158/100")
        yield name, "period beyond the inequality's", law(T_min="106/100", T_max="106/100")
        yield name, "slope wider above", slope(upper="4")
        yield name, "slope wider below", slope(lower="-4")
        yield name, "ends swapped", slope(lower="1", upper="-1")
        yield name, "slope of another sign", slope(lower="5", upper="6")
        yield name, "slope of another state", slope(part=[["0", "0"], ["0", "1"]], lower="-9")
        yield name, "slope in another row", slope(part=[["1", "0"], ["0", "0"]])
        yield name, "longer integrators", lambda d: scaled(d["plant"]["A"][0], 1, "11/10")
        yield name, "no integrators", lambda d: d["plant"]["A"][0].__setitem__(0, "-1/100")
        yield name, "in one step", lambda d: (law(T_min="1", T_max="1")(d), data(steps=1)(d))
        yield name, "lost samples", law(T_max="6/5", lost=1)
        yield name, "lost by chance", law(probability="1/10")
        yield name, "maps of nothing", data(S=zeros, T=zeros, Q=[["1", "0"], ["1"]])
    for name in ("linear", "linear_held"):
        yield name, "gain", lambda d: scaled(d["gain"][0], 0, 9)
        yield name, "unstable", lambda d: scaled(d["plant"]["A"][1], 0, -9)
        yield name, "output", lambda d: scaled(d["plant"]["C"][0], 0, -9)
        yield name, "slopes", plant(slopes=[{"part": [["0", "0"], ["1", "0"]], "lower": "-9", "upper": "9"}])
        yield name, "a range of periods", law(T_min="1/2")
        yield name, "faster fall", lambda d: scaled(of(d, "set")["data"], "rho_squared", "1/9")
        yield name, "form of fewer states", lambda d: of(d, "set")["data"]["Q"].pop()
        yield name, "taken for a chain", data(steps=0)
    bad = [["1"], ["-6/5"]]
    maps, below = data(T=[["6/5", "1"]]), data(Q=[["-1"]], rho_squared="1/2")

    def alone(d: Any) -> None:
        d.update(gain=bad, certificates=[of(d, "set")])
        maps(d)

    yield "set", "gain with its maps", alone
    yield "set", "form below 0 that falls", lambda d: (alone(d), below(d))
    yield "set_chain", "slope wider", slope(upper="30")
    yield "set_feedforward", "slope wider", slope(upper="3")
    yield "set_feedforward", "taken for a chain", data(steps=0)
    yield "set_feedforward", "too few steps", data(steps=1)


FAULTS = [*faults(), *sets()]


@pytest.mark.parametrize(("name", "what", "plant"), FAULTS, ids=[f"{name}: {what}" for name, what, _ in FAULTS])
def test_planted_faults_are_found(name: str, what: str, plant: Fault) -> None:
    assert len(FAULTS) >= 100
    document = proof(name)
    before = copy.deepcopy(document)
    plant(document)
    assert document != before
    with pytest.raises(RefusedError):
        check(document)


SCALAR: Any = {
    "schema_version": 1, "observer": "corrected", "gain": [["0"]],
    "plant": {
        "states": ["x"], "A": [["1"]], "C": [["1"]], "slopes": [], "outputs": [], "disturbance": ["0"], "noise": ["0"],
        "intensity": [["0"]], "covariance": [["0"]],
    },
}  # fmt: skip


@pytest.mark.parametrize(
    ("A", "P", "inverse", "told"),
    [
        ("-1", ["1", "1"], "1", None), ("1", ["-1", "-1"], "1", r"P\(0\) is not positive definite"),
        ("1", ["2", "1"], "0", "a basis that is none"), ("1", ["2", "1"], "1", "not positive definite"),
    ],
)  # fmt: skip
def test_an_unstable_state_that_is_not_corrected_is_refused(A: str, P: Any, inverse: str, told: str | None) -> None:
    law = {"T_min": "1/10", "T_max": "1/10", "lost": 0, "probability": "0"}
    data: Any = {"degrees": [1, 2], "pieces": [1, 0], "sigma": "0", "basis": [["1"]], "inverse": [[inverse]]}
    data["P"] = [[[value]] for value in P]
    document = copy.deepcopy(SCALAR) | {"certificates": [{"method": "clock", "law": law, "data": data}]}
    document["plant"]["A"] = [[A]]
    if told is None:
        assert check(document)
    else:
        with pytest.raises(RefusedError, match=told):
            check(document)


def test_what_the_series_leaves_out_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cdobs_cli.export.check_proof.FINE", 24)  # 1 + 1 + 1/2 + 1/6 + 1/24 are not rounded
    box = reduce(Matrix.__add__, series(Matrix([[Interval(Fraction(1))]]))).rows[0][0]
    assert box.low <= Fraction(271828, 100000) and box.high >= Fraction(271829, 100000)


def test_the_checker_stands_alone() -> None:
    text = CHECKER.read_text()
    imported = {line.split()[1].split(".")[0] for line in text.splitlines() if line.startswith(("import ", "from "))}
    assert imported <= set(sys.stdlib_module_names)
    assert len(text.splitlines()) <= 400


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
    SPECS["scalar"] = (ROOT / "specs/interval_scalar.yaml").read_text()
    with pytest.raises(UsageError, match="at once"):
        written("late")
    with pytest.raises(UsageError, match="certificates by hurwitz"):
        written("scalar")


def test_the_command_writes_both(tmp_path: Path) -> None:
    (tmp_path / "p.yaml").write_text(GIVEN)
    assert forked(["check", "p.yaml", "--effort", "0"], tmp_path).returncode == 0
    done = forked(["export", "p.yaml", "--to", "proof", "--effort", "0"], tmp_path)
    assert done.returncode == 0, done.stderr
    folder = tmp_path / "results/p/export/proof"
    assert {path.name for path in folder.iterdir()} == {"proof.json", "check_proof.py"}
    assert check(json.loads((folder / "proof.json").read_text()))


def test_of_a_period_that_short_steps_do_not_reach_no_proof_is_written() -> None:
    SPECS["far"] = SPECS["set_feedforward"].replace("period: 1", "period: 1.375")
    with pytest.raises(UsageError, match="short steps"):
        written("far")


Rows = list[list[Fraction]]


def joined(matrices: list[Rows]) -> NDArray[np.float64]:
    return np.array([[[float(x) for x in row] for row in M] for M in matrices])


def drawn(rng: np.random.Generator, low: float, high: float) -> Fraction:
    return Fraction(int(rng.integers(round(low * 1000), round(high * 1000) + 1)), 1000)


def corners_of(low: Rows, high: Rows) -> list[Matrix]:
    """All matrices whose entries are ends."""
    entries = [(min(a, b), max(a, b)) for x, y in zip(low, high, strict=True) for a, b in zip(x, y, strict=True)]
    chosen = product(*({a, b} for a, b in entries))
    return [Matrix([one[i * len(low) : (i + 1) * len(low)] for i in range(len(low))]) for one in chosen]


def bang_bang(flows: list[Matrix], rng: np.random.Generator) -> NDArray[np.float64]:
    """The transition over time 1 of flows that switch at random times."""
    ends = np.sort(np.concatenate([[0.0, 1.0], rng.random(rng.integers(0, 6))]))
    floats, whole = joined([F.rows for F in flows]), np.eye(len(flows[0].rows))
    for start, end in pairwise(ends):
        whole = expm((end - start) * floats[rng.integers(len(flows))]) @ whole
    return whole


def holds_all(box: Matrix, flows: list[Matrix], rng: np.random.Generator, runs: int = 150) -> None:
    """Whether random slopes, and each corner for ever, stay in the box."""
    low, high = joined([box.each(lambda x: x.low).rows])[0], joined([box.each(lambda x: x.high).rows])[0]
    room = 1e-9 * (1 + np.abs(high))
    reached = [expm(joined([F.rows])[0]) for F in flows] + [bang_bang(flows, rng) for _ in range(runs)]
    for transition in reached:
        assert np.all(transition >= low - room) and np.all(transition <= high + room)


@pytest.mark.parametrize("seed", range(8))
def test_the_box_of_a_chain_holds_random_slopes_and_its_ends_are_those_of_the_tool(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 2 + seed % 3
    shift = [[Fraction(j == i + 1) for j in range(n)] for i in range(n - 1)]
    lo, hi = ([drawn(rng, *ends) for _ in range(n)] for ends in ((-1, 0), (0, 1.5)))
    flows = corners_of([*shift, lo], [*shift, hi])
    box = chain_box(flows, n)
    holds_all(box, flows, rng)
    theirs = box_31(LastRow(tuple(lo), tuple(hi)), arb(1))
    for ours, end in (
        (box.each(lambda x: x.low), theirs.lower.balls()),
        (box.each(lambda x: x.high), theirs.upper.balls()),
    ):
        gap = max(float(abs(fraction_ball(ours.rows[i][j]) - end[i, j]).upper()) for i in range(n) for j in range(n))
        assert gap < 1e-25


@pytest.mark.parametrize(("lo", "hi"), [((-1, 0), (1, 0)), ((-2, -1, 0), (1, 1, 1)), ((-3, 0, -1, 0), (0, 0, 0, 1))])
def test_the_box_of_a_chain_is_found_up_to_delta_star_and_refused_beyond(lo: Any, hi: Any) -> None:
    n = len(lo)
    star = Fraction(str(float(delta_star(LastRow(tuple(map(Fraction, lo)), tuple(map(Fraction, hi)))).mid())))
    shift = [[Fraction(j == i + 1) for j in range(n)] for i in range(n - 1)]
    for factor, is_within in ((Fraction(10**6 - 1, 10**6), True), (Fraction(10**6 + 1, 10**6), False)):
        delta = star * factor
        rows = [[Fraction(end) * delta ** (n - k) for k, end in enumerate(one)] for one in (lo, hi)]
        flows = corners_of([*shift, rows[0]], [*shift, rows[1]])
        if is_within:
            holds_all(chain_box(flows, n), flows, np.random.default_rng(n), 20)
        else:
            with pytest.raises(RefusedError, match="longer than a chain"):
                chain_box(flows, n)


@pytest.mark.parametrize("seed", range(6))
def test_the_box_by_steps_holds_random_slopes_of_any_plant(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = 2 + seed % 2
    low = [[drawn(rng, -1.5, 1) for _ in range(n)] for _ in range(n)]
    high = [[x + drawn(rng, 0, 1) * (rng.random() < 0.5) for x in row] for row in low]
    U = Matrix([Interval(a, b) for a, b in zip(*pair, strict=True)] for pair in zip(low, high, strict=True))
    step = reduce(Matrix.__add__, series(U * Interval(Fraction(1, 4))))
    holds_all(reduce(Matrix.__matmul__, [step] * 4), corners_of(low, high), rng)


def test_the_series_of_one_flow_is_its_exponential() -> None:
    flow = [list(map(Fraction, row)) for row in (("1", "-2", "0"), ("1/3", "0", "7"), ("-5", "1", "-9"))]
    box = reduce(Matrix.__add__, series(Matrix(flow).each(Interval)))
    exact = ExactMatrix([[str(x) for x in row] for row in flow]).balls().exp(arb(1))
    for i, j in product(range(3), repeat=2):
        low, high = (fraction_ball(end) for end in (box.rows[i][j].low, box.rows[i][j].high))
        assert not low > exact[i, j] and not high < exact[i, j] and high - low < 1e-30


def numbers(rows: Any) -> NDArray[np.float64]:
    return np.array([[float(Fraction(x)) for x in row] for row in rows])


def form(data: Any) -> NDArray[np.float64]:
    """Q of a certificate of a set."""
    size = range(len(data["Q"]))
    return np.array([[float(Fraction(data["Q"][min(i, j)][abs(i - j)])) for j in size] for i in size])


@pytest.mark.parametrize("name", ["set", "set_full", "set_chain"])
def test_the_slowest_fall_is_that_of_all_corners_of_the_box(name: str) -> None:
    document = proof(name)
    one, plant = of(document, "set"), document["plant"]
    document["certificates"] = [one]
    data, n, T = one["data"], len(plant["states"]), Fraction(one["law"]["T_max"])
    lo, hi = [Fraction(0)] * n, [Fraction(0)] * n
    for slope in plant["slopes"]:
        for j, share in enumerate(slope["part"][-1]):
            lo[j] += Fraction(share) * Fraction(slope["lower"])
            hi[j] += Fraction(share) * Fraction(slope["upper"])
    lo = [min(a + Fraction(x), Fraction(0)) for a, x in zip(lo, plant["A"][-1], strict=True)]
    hi = [max(a + Fraction(x), Fraction(0)) for a, x in zip(hi, plant["A"][-1], strict=True)]
    box = box_31(LastRow(tuple(lo), tuple(hi)), fraction_ball(T))
    center, radius = box.floats
    root = np.linalg.cholesky(form(data)).T
    signs = np.array(list(product((-1, 1), repeat=n * n))).reshape(-1, n, n)
    maps = root @ numbers(data["T"]) @ (center + signs * radius) @ numbers(data["S"]) @ np.linalg.inv(root)
    worst = float(max(np.linalg.norm(maps, 2, axis=(1, 2))) ** 2)
    for factor, is_enough in ((1 + 1e-6, True), (1 - 1e-6, False)):
        data["rho_squared"] = str(Fraction(worst * factor))
        if is_enough:
            assert check(document)
        else:
            with pytest.raises(RefusedError, match="falls by over a period"):
                check(document)


SHIPPED = ("pendulum_set", "pendulum_printed_set", "pendulum_corrected", "feedforward")


@pytest.mark.parametrize("name", SHIPPED)
def test_the_sets_of_shipped_specs_are_verified(name: str) -> None:
    SPECS[name] = (ROOT / f"specs/reachability_{name}.yaml").read_text()
    assert any(told.startswith("set: the error decays") for told in check(proof(name)))


@pytest.mark.parametrize("name", ["set", "set_full", "set_chain", "set_feedforward", "set_linear", "linear"])
def test_the_fall_is_that_of_random_slopes(name: str) -> None:
    document, rng = proof(name), np.random.default_rng(1)
    plant, one = document["plant"], of(document, "set")
    A, K, C, T = (
        numbers(plant["A"]),
        numbers(document["gain"]),
        numbers(plant["C"]),
        float(Fraction(one["law"]["T_max"])),
    )
    data, n = one["data"], len(plant["states"])
    Q = form(data)
    S, back = numbers(data["S"]), np.linalg.pinv(numbers(data["S"]))
    for _ in range(200):
        ends = np.sort(np.concatenate([[0.0, T], T * rng.random(rng.integers(0, 6))]))
        whole = np.eye(n)
        for start, end in pairwise(ends):
            slopes = [float(Fraction(s[rng.choice(["lower", "upper"])])) * numbers(s["part"]) for s in plant["slopes"]]
            whole = expm((end - start) * sum(slopes, A)) @ whole
        z = rng.standard_normal(len(Q))
        after = (np.eye(n) - K @ C) @ whole @ S @ z
        later = back @ after
        assert np.allclose(S @ later, after)
        assert later @ Q @ later <= float(Fraction(data["rho_squared"])) * (z @ Q @ z) * (1 + 1e-9)
