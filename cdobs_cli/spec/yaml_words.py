"""What is wrong with a text that is no YAML, in words that say what to write; the parser's own words are for its
authors."""

from __future__ import annotations

import re

_LONGEST_LINE = 1000  # characters of a line that is looked at
_LONGEST = 60  # characters of a line that is shown as it is to be
_KEY_AND_COLON = re.compile(r"\s*(?:- )?([A-Za-z_]\w*):\s+([^\"'\[{&*!|>#].*:(?:\s.*|))\Z")
_KINDS = (
    (re.compile(r"found character '\\t'"), "a tab", "YAML indents with spaces: write two spaces for it"),
    (re.compile(r"found character '([@`%|&*!?-])'"), "a value that begins with a sign of YAML", "put it in quotes"),
    (re.compile(r"expected ',' or ']'"), "a list that is not closed", "write ] at its end, and , between its entries"),
    (re.compile(r"expected ',' or '}'"), "a mapping that is not closed", "write } at its end, and , between its keys"),
    (re.compile(r"unexpected end of stream"), "a quote that is not closed", "write the same quote at its end"),
    (re.compile(r"could not find expected ':'"), "a key without a colon", "write key: value"),
    (re.compile(r"unknown escape character"), "a backslash in double quotes", "put the text in single quotes"),
    (re.compile(r"expected <block end>, but found '[]}]'"), "a bracket too many", "close each bracket once"),
    (re.compile(r"sequence entries"), "a list entry on the line of its key", "write - on the next line, or [.., ..]"),
    (
        re.compile(r"expected <block end>"), "a line at another depth than its neighbours",
        "indent the keys of one block by the same number of spaces",
    ),
)  # fmt: skip


def plain_words(problem: str, line: str) -> tuple[str, str | None]:
    """What is wrong, and what to write.

    Args:
        problem: the parser's words.
        line: of the text, where it stopped.
    """
    if "mapping values are not allowed" in problem:
        return _colon(line)
    for pattern, what, hint in _KINDS:
        if pattern.search(problem):
            return f"not YAML: {what}", hint
    return f"not YAML: {problem}", None


def _colon(line: str) -> tuple[str, str]:
    typed = _KEY_AND_COLON.match(line.rstrip()) if len(line) <= _LONGEST_LINE else None
    if typed is None:
        what = "not YAML: a key and its colon where none can stand"
        return what, "put a value that holds a colon in quotes, and indent the keys of one block alike"
    key, value = typed.groups()
    shown = f'{key}: "{value}"' if len(line) <= _LONGEST and '"' not in value and "\\" not in value else f'{key}: ".."'
    return "not YAML: a second colon on the line", f"put a value that holds a colon in quotes: {shown}"
