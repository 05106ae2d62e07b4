"""Builds the site: `python docs/build.py FOLDER` writes every page as Markdown, has Sphinx make HTML of it, and sees
that no page fetches anything.

Pages that say what the code says (keys of the spec, functions, shipped specs, sources, words) are made here from the
code, each time. Nothing but `main` needs the generator.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

import yaml

from cdobs_cli.exact.language import LANGUAGE, MACROS, SUBSTITUTES, TYPED_FUNCTIONS
from cdobs_cli.exact.parser import CONSTANTS
from cdobs_cli.exact.shapes import Kink
from cdobs_cli.families import FAMILIES
from cdobs_cli.labels import SECONDS
from cdobs_cli.report.references import bibliography
from cdobs_cli.spec.schema import json_schema

DOCS = Path(__file__).parent
SPECS = DOCS.parent / "specs"
EXPLAIN = "cdobs_cli.explain"
Schema = Mapping[str, Any]

# Of the tutorial, made when the site is built: the results of each of its specs, and what is drawn of them.
TUTORIAL = {
    "motor.yaml": (["run"], ("states.svg", "error.svg")),
    "motor_slow.yaml": (["simulate", "--witness", "convergence"], ("witness_convergence_run.svg",)),
}


def write_pages(folder: Path) -> None:
    """Every page of the site as Markdown: those that are written, and those that are made."""
    shutil.copytree(DOCS, folder, ignore=shutil.ignore_patterns("__pycache__", "build.py"), dirs_exist_ok=True)
    made = {"spec": spec_page(), "functions": functions_page(), "gallery": gallery_page(), "sources": sources_page()}
    for name, text in (made | word_pages()).items():
        (folder / f"{name}.md").parent.mkdir(exist_ok=True)
        (folder / f"{name}.md").write_text(text, encoding="utf-8")


# The spec, key by key.


def spec_page() -> str:
    """From the schema: a section for each block, an entry for each key with what it takes."""
    schema = json_schema()
    titles = _titles(schema)
    lines = [
        "# The spec, key by key", "",
        "What `cdobs schema` prints, for reading. Numbers are decimals, or constant expressions in quotes "
        '(`"sqrt(2)"`, `"1/8"`), and are exact. [Expressions](expressions.md) stand in quotes. '
        "An editor that knows YAML schemas shows the same words while you type.", "",
        *_entries(schema, titles),
    ]  # fmt: skip
    for name, title in titles.items():
        block = schema["definitions"][name]
        lines += ["", f"## {title}", "", _plain(block["description"]), "", *_entries(block, titles)]
    return "\n".join(lines) + "\n"


def _titles(schema: Schema) -> dict[str, str]:
    """The title of each block by its name: the first path that leads to it, in the order of the keys."""
    titles: dict[str, str] = {}
    open_parts: list[tuple[str, Any]] = list(schema["properties"].items())
    while open_parts:
        path, part = open_parts.pop(0)
        names = _references(part)
        inner: list[tuple[str, Any]] = []
        for name in names:
            block = schema["definitions"][name]
            if name not in titles and block.get("properties"):
                titles[name] = _title(path, block, alone=len(names) == 1)
                inner += [(f"{titles[name]}.{key}", entry) for key, entry in block["properties"].items()]
        open_parts[:0] = inner
    return titles


def _title(path: str, block: Schema, *, alone: bool) -> str:
    """A block among others at its path is told by its family, or by the keys that it must have."""
    family = block["properties"].get("family", {}).get("const")
    return path if alone else f"{path}: {family or ', '.join(block.get('required', ()))}"


def _references(part: Any) -> list[str]:
    """Names of the blocks that an entry may hold, in order."""
    if isinstance(part, list):
        return [name for one in part for name in _references(one)]
    if not isinstance(part, dict):
        return []
    own = [part["$ref"].rsplit("/", 1)[1]] if "$ref" in part else []
    return own + [name for key, one in part.items() if key not in ("$ref", "if") for name in _references(one)]


def _entries(block: Schema, titles: Mapping[str, str]) -> list[str]:
    required = block.get("required", ())
    lines = []
    for key, entry in block.get("properties", {}).items():
        facts = [_kinds(entry, titles)]
        if key in required:
            facts.append("required")
        elif entry.get("default") is not None and entry["default"] != []:
            facts.append(f"`{_typed(entry['default'])}` where left out")
        told = "; ".join(fact for fact in facts if fact)
        lines.append(f"- **`{key}`** ({told}): {_plain(entry['description'])}")
    return lines


def _typed(value: Any) -> str:
    return value if isinstance(value, str) else yaml.safe_dump(value, default_flow_style=True).splitlines()[0]


def _kinds(entry: Any, titles: Mapping[str, str]) -> str:
    """What a value may be, in words."""
    options = [entry]
    for one in options:
        options += [*one.get("anyOf", ()), *one.get("oneOf", ()), *one.get("allOf", ())]
    words: list[str] = []
    for one in options:
        if "if" in one:
            title = titles[one["then"]["$ref"].rsplit("/", 1)[1]]
            words.append(f"[{title.rsplit(' ', 1)[1]}](#{slug(title)})")
            continue
        if "const" in one or "enum" in one:
            words += [f"`{_typed(value)}`" for value in one.get("enum", [one.get("const")])]
        elif "$ref" in one:
            title = titles[one["$ref"].rsplit("/", 1)[1]]
            words.append(f"[a block](#{slug(title)})")
        elif one.get("type") == "array":
            inner = _references(one["items"]) if "items" in one else []
            words.append(f"a list of [blocks](#{slug(titles[inner[0]])})" if inner else _listed(one))
        elif one.get("type") == "object" and one.get("additionalProperties"):
            inner = _references(one["additionalProperties"])
            what = f" to [blocks](#{slug(titles[inner[0]])})" if inner else ""
            words.append(f"a mapping from names{what}")
        elif one.get("type") == "object" and "properties" in one and one is not entry:
            words.append(f"`{{{', '.join(f'{name}: ..' for name in one['properties'])}}}`")
        elif "anyOf" not in one and isinstance(one.get("type"), str) and one["type"] not in ("null", "object"):
            words.append(_WORDS[one["type"]])
    if "a number" in words and "text" in words:
        words = [word for word in words if word != "text"]
    return " or ".join(dict.fromkeys(words)) or "a block"


def slug(heading: str) -> str:
    """The anchor of a heading."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


_WORDS = {"string": "text", "number": "a number", "integer": "an integer", "boolean": "`true` or `false`"}


def _listed(entry: Any) -> str:
    """Lists, lists of rows and lists of matrices."""
    depth, inner = 0, entry
    while isinstance(inner, dict) and inner.get("type") == "array" and "items" in inner:
        depth, inner = depth + 1, inner["items"]
    if depth > 1:
        return "a matrix" if depth == 2 else "a list of matrices"
    ends = entry.get("prefixItems") or (entry.get("minItems") == 2 == entry.get("maxItems"))
    return "`[lower, upper]`" if ends else "a list"


def _plain(text: str) -> str:
    return " ".join(text.split()).replace("<", "&lt;").replace("*", "\\*")


# The functions of expressions.


def functions_page() -> str:
    """From the language's records: what may be called, and what to write instead of what may not."""
    lines = [
        "# Functions of expressions", "", "Made from the records that the tool itself reads expressions by.", "",
        "| function | arguments | slopes | defined |", "|---|---|---|---|",
    ]  # fmt: skip
    for name, counts in sorted(TYPED_FUNCTIONS.items()):
        arguments = " or ".join(map(str, counts))
        if name in MACROS:
            count, rule = MACROS[name]
            letters = _arguments(count)
            lines.append(f"| `{name}` | {arguments} | stands for `{rule(*letters)}` | where that is |")
            continue
        function = LANGUAGE[name]
        slopes = "two, on either side of its corner" if isinstance(function.shape, Kink) else "one"
        where = " and ".join(f"`{what}` {_NEEDS[need]}" for what, need in _conditions(name)) or "everywhere"
        lines.append(f"| `{name}` | {arguments} | {slopes} | {where} |")
    constants = " and ".join(f"`{name}`" for name in CONSTANTS)
    lines += [
        "",
        f"Constants: {constants}. `sat(x)` is `sat(x, -1, 1)`. x, y, z are the arguments, in order.",
        "",
    ]
    lines += ["## What to write instead", "", "| typed | instead |", "|---|---|"]
    lines += [f"| `{name}` | {_plain(hint)} |" for name, hint in SUBSTITUTES.items()]
    return "\n".join(lines) + "\n"


_NEEDS = {"nonzero": "is not 0", "positive": "is above 0", "nonnegative": "is not below 0"}


def _arguments(count: int) -> tuple[Any, ...]:
    from cdobs_cli.exact.expression import Variable

    return tuple(Variable(letter) for letter in ("x", "y", "z")[:count])


def _conditions(name: str) -> Iterator[tuple[Any, str]]:
    function = LANGUAGE[name]
    yield from function.conditions(*_arguments(function.arity if function.partials else max(function.typed)))


# The shipped specs.


def gallery_page() -> str:
    """Every shipped spec: its title, family and law, what is expected of it, and its text."""
    lines = [
        "# Gallery", "",
        "Every spec that ships, made from `specs/`. A test runs each and sees that what it expects is so. "
        "`make demo` runs all of them to reports.", "",
    ]  # fmt: skip
    shown = [(path, yaml.safe_load(path.read_text(encoding="utf-8"))) for path in sorted(SPECS.glob("*.yaml"))]
    groups = {"plant": "Plants of the trade", **{name: f"Family {name}" for name in FAMILIES}}
    for prefix, heading in groups.items():
        lines += [f"## {heading}", ""]
        for path, spec in shown:
            if path.name.startswith(f"{prefix}_"):
                lines += [*_example(path, spec), ""]
    return "\n".join(lines) + "\n"


def _example(path: Path, spec: Mapping[str, Any]) -> list[str]:
    family = (spec.get("observer") or {}).get("family", "auto")
    expected = [f"- {_expectation(entry)}" for entry in spec.get("expect") or ()]
    return [
        f"### {path.stem}", "",
        f"{_plain(spec['title'])}. Family: `{family}`. Measured: {_law(spec)}.", "",
        "Expected:" if expected else "Expected: that all is proved.", "", *expected, "",
        f"<details><summary>specs/{path.name}</summary>", "", "```yaml", path.read_text(encoding="utf-8").rstrip(),
        "```", "", "</details>",
    ]  # fmt: skip


def _law(spec: Mapping[str, Any]) -> str:
    """When samples come, in words."""
    measurement, unit = spec["measurement"], spec["plant"].get("time_unit", SECONDS)
    if "sensors" in measurement:
        return f"by {' and '.join(measurement['sensors'])}"
    law = measurement["sampling"]
    if "period" in law:
        return f"every {law['period']} {unit}"
    return "when the observer asks" if "updated" in law else f"at most {law['max_period']} {unit} apart"


def _expectation(entry: Mapping[str, Any]) -> str:
    relations = {"at_least": "is at least", "at_most": "is at most", "equals": "is"}
    told = " and ".join(f"{words} `{_typed(entry[name])}`" for name, words in relations.items() if name in entry)
    within = f" within {entry['tolerance']}" if "tolerance" in entry else ""
    source = f" ({_plain(entry['source'])})" if "source" in entry else ""
    return f"`{entry['quantity']}` {told}{within}{source}"


# Sources and words.


def sources_page() -> str:
    """The bibliography, by the keys that claims and reports cite."""
    entries = [f"- **{key}**: {_plain(reference.text)}" for key, reference in sorted(bibliography().items())]
    return (
        "\n".join(["# Sources", "", "The keys are those of reports, claims and `cdobs theorems`.", "", *entries]) + "\n"
    )


def word_pages() -> dict[str, str]:
    """The pages that `cdobs explain` prints, where the package has them, and the page that lists them."""
    heading = "# Every word explained\n\n"
    found = importlib.util.find_spec(EXPLAIN)
    room = Path(found.origin).parent if found is not None and found.origin else None
    files = sorted(room.glob("*.md")) if room is not None else []
    if not files:
        return {"words": f"{heading}What a claim or bound says stands in each report, beside its name.\n"}
    names = [f"words/{file.stem}" for file in files]
    listed = "\n".join(names)
    index = f"{heading}What `cdobs explain ID` prints, for reading.\n\n```{{toctree}}\n:maxdepth: 1\n\n{listed}\n```\n"
    pages = {name: file.read_text(encoding="utf-8") for name, file in zip(names, files, strict=True)}
    return {"words": index} | pages


# What is run to make the site.


def blocks(text: str, language: str) -> list[str]:
    """The fenced blocks of a language."""
    return re.findall(rf"^```{language}\n(.*?)^```$", text, re.MULTILINE | re.DOTALL)


def draw(folder: Path) -> None:
    """The figures of the tutorial's specs."""
    folder.mkdir(exist_ok=True)
    specs = blocks((DOCS / "tutorial.md").read_text(encoding="utf-8"), "yaml")
    with tempfile.TemporaryDirectory() as name:
        for spec, (file, (words, figures)) in zip(specs, TUTORIAL.items(), strict=True):
            (Path(name) / file).write_text(spec, encoding="utf-8")
            subprocess.run(
                [sys.executable, "-m", "cdobs_cli", words[0], "--quiet", file, *words[1:]], cwd=name, check=True
            )
            for figure in figures:
                shutil.copy(Path(name) / "results" / Path(file).stem / "figures" / figure, folder)


_FETCHED = re.compile(
    r"""<(?!a\b)[^>]*\b(?:src|href)\s*=\s*["']?(?:https?:)?//[^>]*>|url\(\s*["']?(?:https?:)?//[^)]*\)"""
)


def fetched(folder: Path) -> list[str]:
    """What pages and styles of a site would fetch from elsewhere."""
    files: Iterable[Path] = (path for path in sorted(folder.rglob("*")) if path.suffix in (".html", ".css"))
    return [f"{path}: {found[0]}" for path in files for found in _FETCHED.finditer(path.read_text(encoding="utf-8"))]


def main(site: Path) -> None:
    """Pages, figures, HTML; every broken link is an error."""
    source = site.parent / "docs-source"
    for folder in (source, site):
        shutil.rmtree(folder, ignore_errors=True)
    write_pages(source)
    draw(source / "figures")
    subprocess.run(
        [sys.executable, "-m", "sphinx", "-q", "-n", "-W", "--keep-going", str(source), str(site)], check=True
    )
    if loose := fetched(site):
        sys.exit("\n".join(["pages that fetch:", *loose]))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
