"""`cdobs explain`: every id has a page, every page is whole and about something that exists, and the command helps."""

from __future__ import annotations

import ast
import json
import re
import shutil
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import get_args, get_type_hints

import pytest
from command import PENDULUM, ROOT, Done, forked, made

from cdobs_cli.certificate import About, ClaimKind, Status, Witness
from cdobs_cli.design import Design
from cdobs_cli.explain.pages import KINDS, Page, find, nearest, pages, read
from cdobs_cli.store import sealed

PACKAGE = ROOT / "cdobs_cli"
NOISY = PENDULUM.replace("sampling: {period: 0.6}", "sampling: {period: 0.6}\n  noise: {lower: [-0.01], upper: [0.01]}")


# ---------------------------------------------------------------- the pages


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.ids[0])
def test_a_page_is_short_and_has_its_three_parts(page: Page) -> None:
    count = sum(len(text.split()) for _, text in page.parts)
    assert 50 <= count <= 180, count
    assert all(text[0].isupper() or text[0] in "`0(c" or text.startswith("e = ") for _, text in page.parts)
    assert all(text.endswith((".", "`.")) for _, text in page.parts)
    assert page.what.startswith(page.first_sentence)
    assert len(page.first_sentence) <= 160


def test_an_id_stands_on_one_page() -> None:
    ids = [one for page in pages() for one in page.ids]
    assert len(ids) == len(set(ids))
    assert {kind for page in pages() for kind in page.kinds} == set(KINDS)


WHOLE = ("## `a`", "claim", "**What it is.** A.", "**Why.** B.", "**Next.** C.")


@pytest.mark.parametrize(
    "blocks", [WHOLE[:4], ("## a", *WHOLE[1:]), (WHOLE[0], "word", *WHOLE[2:]), (*WHOLE[:3], WHOLE[4], WHOLE[3])]
)
def test_a_page_that_is_not_whole_is_refused(blocks: tuple[str, ...]) -> None:
    assert len(list(read("\n\n".join(WHOLE)))) == 1
    with pytest.raises(ValueError, match="a page"):
        list(read("\n\n".join(blocks)))


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.ids[0])
def test_what_a_page_sends_its_reader_to_exists(page: Page) -> None:
    told = " ".join(text for _, text in page.parts)
    for one in re.findall(r'`cdobs explain "?([a-z_.<>]+)"?`', told):
        assert find(one) is not None, one
    commands = set(re.findall(r"`cdobs ([a-z]+)", told))
    source = (PACKAGE / "cli.py").read_text(encoding="utf-8")
    assert all(f"def {name}(" in source or f'"{name}"' in source for name in commands), commands


@pytest.mark.parametrize(
    ("identifier", "page"),
    [
        ("slopes.2.1", "slopes.<i>.<j>"), ("slopes.rho1", "slopes.<quantity>"),
        ("slopes.output.1.2", "slopes.output.<k>.<j>"), ("error.omega", "error.<state>"),
        ("error.omega.reached", "error.<state>.reached"), ("period_max.intervals", "period_max.intervals"),
        ("period_max.clock", "period_max.<method>"), ("error.<state>", "error.<state>"),
    ],
)  # fmt: skip
def test_open_places_are_filled(identifier: str, page: str) -> None:
    found = find(identifier)
    assert found is not None
    assert found.ids[0] == page


@pytest.mark.parametrize("identifier", ["", "slopes.", "slopes.1.x.2", "error.a b", "ERROR.x", "error.x\n"])
def test_what_is_no_id_has_no_page(identifier: str) -> None:
    assert find(identifier) is None


def test_nearest_names() -> None:
    assert nearest("eror.omega")[0] == "error.<state>"
    assert nearest("convergance")[0] == "convergence"
    assert nearest("period_max_any")[0] == "period_max_any_gain"
    assert nearest("qqqq") == []


# ---------------------------------------------------------------- every id has a page


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the spec s.yaml and its results in results/s."""
    folder = tmp_path_factory.mktemp("explained")
    made(folder, NOISY, ("check",))
    (folder / "results").mkdir()
    shutil.move(folder / "out", folder / "results" / "s")
    return folder


@pytest.mark.parametrize("family", ["interval", "updated_sampling", "lpv_zoh", "reachability"])
def test_ids_of_artefacts_have_pages(family: str, tmp_path: Path) -> None:
    example = (PACKAGE / "families" / family / "example.yaml").read_text(encoding="utf-8")
    check = made(tmp_path, example, ("check",)).check
    assert check is not None
    told = {claim["id"] for claim in check["claims"]} | set(check["bounds"])
    told |= {one["method"] for one in (*check["claims"], *check["bounds"].values())} - {None}
    assert len(told) > 5
    assert {one for one in told if find(one) is None} == set()


@cache
def trees() -> dict[Path, ast.Module]:
    return {
        path: ast.parse(path.read_text(encoding="utf-8"))
        for path in sorted(PACKAGE.rglob("*.py"))
        if "explain" not in path.relative_to(PACKAGE).parts and path.name != "explanation.py"
    }


def literal(node: ast.expr | None) -> str | None:
    """A text as it is written, each `{..}` of it a number; None of what begins with one, or is no text."""
    match node:
        case ast.Constant(str(text)):
            return text
        case ast.JoinedStr([ast.Constant(), *_] as parts):
            return "".join(part.value if isinstance(part, ast.Constant) else "1" for part in parts)
    return None


def called(node: ast.Call) -> str:
    return name_of(node.func)


def name_of(node: ast.expr) -> str:
    return node.attr if isinstance(node, ast.Attribute) else getattr(node, "id", "")


def written_ids() -> Iterator[tuple[str, str]]:
    """Ids of claims and bounds, rules, methods and ways of proof that stand in the source, with their places."""
    for path, tree in trees().items():
        judged = {"certify", "bounds", "families", "coordinates"} & set(path.relative_to(PACKAGE).parts)
        for node in ast.walk(tree):
            place = f"{path.name}:{getattr(node, 'lineno', 0)}"
            if isinstance(node, ast.Call) and node.args and called(node) in {"Claim", "_claim", "say"} and judged:
                yield place, literal(node.args[0]) or ""
            if isinstance(node, ast.Call) and called(node) == "Decision":
                yield place, literal(node.args[1]) or ""
            if isinstance(node, ast.Call) and called(node) in {"_message", "Message"}:
                rules = [literal(one) for one in node.args[3:]] + [
                    literal(one.value) for one in node.keywords if one.arg == "rule"
                ]
                # `simulation.{quantity}` is told of each quantity below.
                yield from ((place, rule) for rule in rules if rule and not rule.endswith(".1"))
            if isinstance(node, ast.Subscript) and isinstance(node.ctx, ast.Store) and name_of(node.value) == "bounds":
                yield place, literal(node.slice) or ""
            if isinstance(node, ast.Dict):
                bounds = [isinstance(one, ast.Call) and called(one) in {"Bound", "_period"} for one in node.values]
                yield from (
                    (place, literal(key) or "") for key, is_bound in zip(node.keys, bounds, strict=True) if is_bound
                )
            if isinstance(node, ast.AnnAssign | ast.Assign) and judged and node.value is not None:
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                if {getattr(one, "id", "") for one in targets} & {"how", "rung"} and "ClassVar" in ast.unparse(node):
                    yield place, literal(node.value) or ""
            if isinstance(node, ast.ClassDef) and judged:
                yield from ((place, text) for text in methods_of(node))


def methods_of(node: ast.ClassDef) -> Iterator[str]:
    """Name and way of proof of a class that is a method."""
    values = {
        target.id: literal(part.value)
        for part in node.body
        if isinstance(part, ast.Assign | ast.AnnAssign)
        for target in (part.targets if isinstance(part, ast.Assign) else [part.target])
        if isinstance(target, ast.Name)
    }
    if "rung" in values or "name" in values:
        yield from filter(None, (values.get("name"), values.get("rung"), values.get("how")))


def test_ids_in_the_source_have_pages() -> None:
    found = [(place, one) for place, one in written_ids() if one]
    assert len(found) > 100
    assert [(place, one) for place, one in found if find(one) is None] == []


def test_rungs_conditions_and_rules_have_pages() -> None:
    rungs = {
        text for tree in trees().values() for node in ast.walk(tree) if isinstance(node, ast.ClassDef)
        for text in methods_of(node)
    }  # fmt: skip
    assert {"clock", "wirtinger", "set", "planar", "repaired"} <= rungs
    for rung in rungs:
        for begin in ("period_max", "period_max_any_gain"):
            assert " " in rung or find(f"{begin}.{rung}") is not None
    for condition in ("P", "lmi_26", "side_conditions", "T_1", "T_2"):
        assert find(f"theorem_1.{condition}") is not None
        assert find(f"theorem_1.printed_vertices.{condition}") is not None
    for quantity in ("diverged", "left_domain", "inclusion_margin", "stopped", "implicit", "error_max"):
        assert find(f"simulation.{quantity}") is not None
    for rule in ("spec", "command", "tool", "artefact", "work", "time-limit", "expect", "design", "output"):
        found = find(rule)
        assert found is not None and found.kinds == ("message",)


def test_words_of_artefacts_have_pages() -> None:
    kinds = get_args(get_type_hints(Witness)["kind"])
    outcomes = get_args(get_type_hints(Design)["outcome"])
    words = [*get_args(Status), *get_args(ClaimKind), *get_args(About), *kinds, *outcomes, "required", "by", "margin"]
    assert len(words) > 20
    assert [word for word in words if find(word) is None] == []


@cache
def constants() -> str:
    """Every text in the source, and every name of a function or field."""
    told = []
    for tree in trees().values():
        for node in ast.walk(tree):
            if isinstance(node, ast.Constant) and isinstance(node.value, str):
                told.append(node.value)
            elif isinstance(node, ast.FunctionDef | ast.ClassDef):
                told.append(node.name)
    return "\n".join(told)


@pytest.mark.parametrize("page", pages(), ids=lambda page: page.ids[0])
def test_no_page_is_about_something_that_does_not_exist(page: Page) -> None:
    if not {"claim", "bound", "message", "method"} & set(page.kinds):
        return
    for one in page.ids:
        words = [word for word in re.split(r"[.\s]|<\w+>", one) if word]
        assert words
        assert [word for word in words if word not in constants()] == []


# ---------------------------------------------------------------- the command


def explain(folder: Path, *arguments: str) -> Done:
    return forked(["explain", *arguments], folder)


def test_all_ids_are_listed_by_kind(tmp_path: Path) -> None:
    done = explain(tmp_path)
    assert done.returncode == 0
    assert all(f"\n{title}\n" in done.stdout for title in KINDS.values())
    assert all(f"  {one}" in done.stdout for page in pages() for one in page.ids)
    documents = json.loads(explain(tmp_path, "--format", "json").stdout)
    assert [tuple(one["ids"]) for one in documents] == [page.ids for page in pages()]


def test_a_page(tmp_path: Path) -> None:
    done = explain(tmp_path, "slopes.2.1")
    assert done.returncode == 0
    assert done.stdout.startswith("slopes.2.1  (slopes.<i>.<j>)  [claim]\n\nWhat it is. ")
    assert all(len(line) <= 100 for line in done.stdout.splitlines())
    assert "\nWhy. " in done.stdout and "\nNext. " in done.stdout
    document = json.loads(explain(tmp_path, "slopes.2.1", "--format", "json").stdout)
    assert document["id"] == "slopes.2.1" and document["ids"] == ["slopes.<i>.<j>"] and document["results"] is None


@pytest.mark.parametrize("columns", [20, 57, 300])
def test_paragraphs_are_as_wide_as_the_terminal(
    columns: int, results: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(columns))
    shutil.copytree(results, tmp_path, dirs_exist_ok=True)
    told = explain(tmp_path, "convergence", "s.yaml").stdout.splitlines()
    assert 0.8 * min(100, max(40, columns)) < max(map(len, told)) <= min(100, max(40, columns))


@pytest.mark.parametrize(
    "path", ["bounds.period_max.proved", "check.claims.convergence.status", "claims.slopes.2.1.margin"]
)
def test_what_expect_names_is_understood(path: str, tmp_path: Path) -> None:
    assert explain(tmp_path, path).returncode == 0


def test_an_unknown_id_gets_the_nearest_and_exit_code_2(tmp_path: Path) -> None:
    done = explain(tmp_path, "convergance")
    assert (done.returncode, done.stdout) == (2, "")
    assert "nothing is known of 'convergance'; near it: convergence" in done.stderr
    document = json.loads(explain(tmp_path, "convergance", "--format", "json").stdout)
    assert document["exit_code"] == 2


@pytest.mark.parametrize("arguments", [["s.yaml"], ["there"], ["s.yaml", "convergence"]])
def test_a_path_in_the_place_of_an_id(arguments: list[str], tmp_path: Path) -> None:
    (tmp_path / "there").mkdir()
    done = explain(tmp_path, *arguments)
    assert done.returncode == 2
    assert f"`cdobs explain convergence {arguments[0]}`" in done.stderr


@pytest.mark.parametrize("identifier", ["\x1b[31mred", "::error ::x", "x" * 5000, "\udcff", "a\nb"])
def test_nothing_that_is_typed_is_obeyed(identifier: str, tmp_path: Path) -> None:
    done = explain(tmp_path, identifier)
    assert done.returncode == 2
    assert "\x1b" not in done.stderr and "\n::" not in done.stderr
    assert "internal error" not in done.stderr


def test_what_the_results_of_a_spec_say(results: Path) -> None:
    done = explain(results, "convergence", "s.yaml")
    assert done.returncode == 0
    assert "In the results of s.yaml (results/s, verdict proved, gain found):" in done.stdout
    assert "  convergence: proved (consequence, required)\n      The error converges to 0" in done.stdout
    said = json.loads(explain(results, "period_max", "s.yaml", "--format", "json").stdout)["results"]
    check = json.loads((results / "results" / "s" / "check.json").read_text())
    assert said["bounds"] == {"period_max": check["bounds"]["period_max"]}
    assert (said["verdict"], said["claims"], said["note"]) == ("proved", [], None)


def test_results_by_pattern_method_status_and_kind(results: Path) -> None:
    told = explain(results, "slopes.<i>.<j>", "s.yaml").stdout
    assert "  slopes.2.1: proved (premise, required)" in told
    told = explain(results, "slopes.1.1", "s.yaml").stdout
    assert "there is no slopes.1.1; of the same kind are:\n  slopes.2.1: proved" in told
    assert "  slopes.2.1: proved" in explain(results, "range of the functions", "s.yaml").stdout
    assert "  convergence: proved" in explain(results, "consequence", "s.yaml").stdout
    assert "  nothing there is about it" in explain(results, "theorem_1.gain", "s.yaml").stdout
    told = explain(results, "error.omega", "s.yaml").stdout
    assert "  error.omega: proved 0." in told and "less is better" in told


def test_results_of_a_spec_that_leaves_its_family_open(tmp_path: Path) -> None:
    lines = PENDULUM.splitlines(keepends=True)
    text = "".join(one for one in lines if not one.startswith(("observer:", "  family:", "  method:")))
    made(tmp_path, text, ("check",))
    told = " ".join(explain(tmp_path, "convergence", "s.yaml", "-o", ".").stdout.split())
    assert "no current design.json" in told  # they are in out/, not in s/
    (tmp_path / "out").rename(tmp_path / "s")
    told = explain(tmp_path, "convergence", "s.yaml", "-o", ".").stdout
    assert "  convergence: proved (consequence, required)" in told


def test_units_are_those_of_the_spec(results: Path, tmp_path: Path) -> None:
    text = NOISY.replace("plant:\n", "plant:\n  time_unit: min\n")
    (tmp_path / "s.yaml").write_text(text)
    shutil.copytree(results / "results", tmp_path / "results")
    assert " min, refuted " in explain(tmp_path, "period_max", "s.yaml").stdout


def test_without_results_the_command_that_makes_them_is_named(tmp_path: Path) -> None:
    (tmp_path / "p q.yaml").write_text(PENDULUM)
    done = explain(tmp_path, "convergence", "p q.yaml", "-o", "there")
    assert done.returncode == 0
    told = " ".join(done.stdout.split())
    assert "no current design.json for this spec; run `cdobs check` first: `cdobs check 'p q.yaml' --out there`" in told
    assert not (tmp_path / "there").exists()


def test_results_of_another_spec_or_edited_ones_are_not_shown(results: Path, tmp_path: Path) -> None:
    shutil.copytree(results, tmp_path, dirs_exist_ok=True)
    (tmp_path / "s.yaml").write_text(NOISY.replace("0.6", "0.5"))
    assert "no current design.json for this spec" in explain(tmp_path, "convergence", "s.yaml").stdout
    (tmp_path / "s.yaml").write_text(NOISY)
    check = tmp_path / "results" / "s" / "check.json"
    check.write_text(check.read_text().replace('"proved"', '"refuted"', 1))
    told = " ".join(explain(tmp_path, "convergence", "s.yaml").stdout.split())
    assert "check.json was edited or damaged" in told and "verdict" not in told.split("In the results")[1]
    check.write_text(json.dumps(sealed({"schema_version": 1, "claims": 3, "digests": {}})))
    done = explain(tmp_path, "convergence", "s.yaml")
    assert done.returncode == 0 and "Traceback" not in done.stderr + done.stdout


@pytest.mark.parametrize("spec", ["nope.yaml", ".", "broken.yaml"])
def test_what_is_no_spec_is_an_error(spec: str, tmp_path: Path) -> None:
    (tmp_path / "broken.yaml").write_text("plant: [")
    done = explain(tmp_path, "convergence", spec)
    assert (done.returncode, done.stdout) == (2, "")
    assert "Traceback" not in done.stderr


# ---------------------------------------------------------------- in reports


def test_ids_in_a_report_lead_to_their_pages(results: Path, tmp_path: Path) -> None:
    shutil.copytree(results, tmp_path, dirs_exist_ok=True)
    assert forked(["report", "s.yaml", "-q", "--effort", "0"], tmp_path).returncode == 0
    page = (tmp_path / "results" / "s" / "report.html").read_text(encoding="utf-8")
    head, words = page.split('<details class="words">')
    places = re.findall(r'<dt id="(word-[\w-]+)">', words)
    assert len(places) == len(set(places)) > 8
    links = re.findall(r'<a class="word" href="#([\w-]+)" title="([^"]+)">', head)
    assert len(links) > 8
    assert {place for place, _ in links} <= set(places)
    assert ("word-convergence", find("convergence").first_sentence) in links  # type: ignore[union-attr]
    check = json.loads((tmp_path / "results" / "s" / "check.json").read_text())
    for one in (*(claim["id"] for claim in check["claims"]), *check["bounds"]):
        assert f'href="#{place_of(one)}"' in head
    assert "http" not in words


def place_of(identifier: str) -> str:
    from cdobs_cli.report.glossary import anchor

    page = find(identifier)
    assert page is not None
    return anchor(page)


def test_no_two_pages_share_a_place() -> None:
    from cdobs_cli.report.glossary import anchor

    assert len({anchor(page) for page in pages()}) == len(pages())
