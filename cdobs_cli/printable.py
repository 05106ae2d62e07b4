"""Text that nobody obeys: what a terminal, a log, a page or a CI service would act on is shown as an escape.

Names, titles, keys and file names come from users. Every writer passes what it prints through one of these.
"""

from __future__ import annotations

import re

# Controls (C0, DEL, C1), marks that turn or hide text, separators of lines, lone surrogates, tags.
_OBEYED = re.compile(
    "[\x00-\x1f\x7f-\x9f\u061c\u200b\u200e\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff\U000e0000-\U000e007f]"
)
# `::error ..` at the start of a line, `##[..]` and `##vso[..]` anywhere in one.
_COMMAND = re.compile(r"^\s*:(?=:)|#(?=#[\[A-Za-z])")


def printable(text: str) -> str:
    r"""Text on one line: `\x1b`, `\n`, `\u202e` in the place of each character that would be obeyed."""
    return _OBEYED.sub(lambda match: match.group().encode("unicode_escape").decode("ascii"), text)


def line(text: str) -> str:
    """One line for a terminal or a log, that no CI service takes for a command."""
    return _COMMAND.sub(lambda match: f"{match.group()[:-1]}\\x{ord(match.group()[-1]):02x}", printable(text))


def lines(text: str) -> str:
    """Several lines for a terminal or a log: only our own line feeds stay."""
    return "\n".join(map(line, text.split("\n")))


def page(text: str) -> str:
    """A page of ours, whatever was put into it: nothing but text and line feeds."""
    return "\n".join(map(printable, text.split("\n")))
