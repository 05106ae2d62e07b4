"""Reading is bounded by counted work: inputs that grow without end are refused at their line, and equally each time."""

# ruff: noqa: E501 - hostile specs stand on one line each

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable
from pathlib import Path

import pytest

from cdobs_cli.errors import Problem, SpecError
from cdobs_cli.exact import budget
from cdobs_cli.exact.budget import READING, WorkError
from cdobs_cli.exact.expression import MAX_DEPTH, Expression, Variable, call
from cdobs_cli.exact.parser import parse
from cdobs_cli.exact.rational import simplify
from cdobs_cli.spec import model
from cdobs_cli.spec.model import load

SPECS = sorted((Path(__file__).parents[2] / "specs").glob("*.yaml"))
Write = Callable[..., Path]


def spec(dynamics: list[str], *, coordinates: str | None = None, domain: str = "", more: str = "") -> str:
    """A plant in states x1, x2, .. that is measured by x1."""
    states = ", ".join(f"x{i + 1}" for i in range(len(dynamics)))
    lines = [
        "spec_version: 1",
        "plant:",
        f"  states: [{states}]",
        '  output: ["x1"]',
        "  dynamics:",
        *(f'    - "{one}"' for one in dynamics),
    ]
    lines += [f"  coordinates: {coordinates}"] if coordinates else []
    lines += [f"  domain: {domain}"] if domain else []
    return "\n".join(
        [*lines, *([more] if more else []), "measurement: {sampling: {period: 0.1}}", "observer: {family: lpv_zoh}", ""]
    )


def box(n: int) -> str:
    return "{" + ", ".join(f"x{i + 1}: [0.1, 1]" for i in range(n)) + "}"


def map_of(map: list[str]) -> str:
    """A map with some inverse; whether it is one is not asked when reading."""
    return f"{{map: [{', '.join(map)}], inverse: [{', '.join(f'z{i + 1}' for i in range(len(map)))}]}}"


def ring(i: int, n: int) -> str:
    return f"x{i % n + 1}"


RATIONAL = [
    f"{ring(i + 1, 5)}/(1 + {ring(i, 5)}) + {ring(i + 2, 5)}*{ring(i, 5)}/(2 + {ring(i + 3, 5)})" for i in range(5)
]
CHAIN = [f"x{min(i + 2, 8)} + x{i + 1}/(1 + x{i + 1} + x{min(i + 2, 8)})" for i in range(8)]
WAVES = [f"sin(x{min(i + 2, 8)}) + exp(x{i + 1}*x{min(i + 2, 8)})" for i in range(8)]
KINKS = ["x1"] + [
    "'" + " + ".join(f"abs(x{j + 1}*x{i} - {k}/10)*min(x{k + 1}, x{j + 1})" for k in range(4) for j in range(5)) + "'" for i in range(2, 9)
]  # fmt: skip
HOSTILE = {
    "lie, rational rows": spec(RATIONAL, coordinates="lie", domain=box(5)),
    "lie, a chain": spec(CHAIN, coordinates="lie"),
    "lie, nested functions": spec(WAVES, coordinates="lie"),
    "a map with kinks": spec(["x1"] * 8, coordinates=map_of(KINKS), domain=box(8)),
    "powers of sums": spec(["(x1 + x2 + x3)**60", "(x1 + 2*x2)**60*(x1 - x2)**60", "x1/(1 + x2 + x3)**60"]),
    "powers of powers": spec(["x1**64*x2**64", "(x1**64 + x2)**(1/64)"]),
    "products of sums": spec(["*".join(f"(x1 + x2 + x3 + {k})**3" for k in range(20))] * 3),
    "sums of quotients": spec(["+".join(f"x{k % 4 + 1}/(x1*x2 + x3**2*{k} + {k}*x4 + {k})" for k in range(30))] * 4),
    "nested": spec(["exp(x2*" * 90 + "x1" + ")" * 90, "sqrt(x2 + " * 90 + "x1" + ")" * 90]),
    "many inequalities": spec(
        ["x1"] * 8, coordinates=map_of([f"x{i} + x3*x4*x1" if i > 1 else "x1" for i in range(1, 9)]),
        domain=box(8)[:-1] + ", where: [" + ", ".join(f'"{ring(i, 8)} + {ring(i + 3, 8)} <= 1.{i}"' for i in range(40)) + "]}",
    ),
    "a chain of parameters": spec(["p60*x1"], more="  parameters: {p0: 1, " + ", ".join(f'p{i}: "sin(p{i - 1})*p{i - 1}"' for i in range(1, 61)) + "}"),
    "a long sum": spec(["+".join(["x1"] * 900)]),
}  # fmt: skip


SMALL = READING // 10


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """A budget that is used up sooner; the sentences are the same."""
    monkeypatch.setattr(model, "READING", SMALL)


def refused(path: Path) -> tuple[Problem, ...]:
    """What is wrong with a spec; nothing where it is read."""
    try:
        load(path).normalised()
    except SpecError as error:
        return error.problems
    return ()


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("name", HOSTILE)
def test_what_grows_without_end_ends_within_the_budget(write: Write, name: str) -> None:
    before = budget.spent()
    for problem in refused(write(HOSTILE[name])):
        assert problem.line
        assert len(str(problem)) < 1000
    # One step more than the budget at most, and writing out.
    assert budget.spent() - before < 2 * SMALL


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize("name", ["lie, rational rows", "lie, a chain", "lie, nested functions"])
def test_lie_says_what_to_type(write: Write, name: str) -> None:
    (problem,) = refused(write(HOSTILE[name]))
    assert problem.path == "plant.coordinates"
    assert problem.hint == "type `map` and `inverse`"


@pytest.mark.usefixtures("small")
def test_equal_inputs_cost_the_same(write: Write) -> None:
    """Whatever was read before: operations are counted, and what is remembered is forgotten first."""
    path, costs = write(HOSTILE["sums of quotients"]), []
    for other in ("nested", "powers of sums", "sums of quotients"):
        refused(write(HOSTILE[other], "other.yaml"))
        before = budget.spent()
        refused(path)
        costs.append(budget.spent() - before)
    assert costs[0] == costs[1] == costs[2] > 0


def test_shipped_specs_take_a_tenth_of_the_budget() -> None:
    for path in SPECS:
        before = budget.spent()
        load(path)
        assert budget.spent() - before < READING / 10, path


def test_a_budget_ends_the_work_and_only_its_own() -> None:
    x = parse("1/(1 + x) + 1/(2 + x) + 1/(3 + x)", frozenset("x"))
    with pytest.raises(WorkError), budget.budget(10):
        simplify(x)
    assert str(simplify(x)) != str(x)


def test_equal_trees_are_one_object() -> None:
    a, b = (parse("sin(x)*(x + 1)**2 + pi", frozenset("x")) for _ in range(2))
    assert a is b
    assert copy.deepcopy(a) is a
    assert pickle.loads(pickle.dumps(a)) is a
    assert a != parse("sin(x)*(x + 1)**3 + pi", frozenset("x"))
    assert (a.size, a.depth) == (9, 5)


def test_a_tree_that_recursion_could_not_take_is_not_made() -> None:
    deep: Expression = Variable("x")
    for _ in range(MAX_DEPTH - 1):
        deep = call("sin", deep)
    assert str(deep).count("sin") == MAX_DEPTH - 1
    with pytest.raises(WorkError):
        call("sin", deep)


def test_text_of_a_nested_product_is_written_once() -> None:
    """It was written twice at every level: 2^40 times the innermost."""
    nested: Expression = Variable("x")
    for _ in range(40):
        nested = Variable("y") * (nested / Variable("z"))
    assert parse(str(nested), frozenset("xyz")).variables == {"x", "y", "z"}
