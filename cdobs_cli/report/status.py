"""How verdicts and statuses look: a symbol, a class of colour, a badge."""

from __future__ import annotations

from html import escape

SYMBOLS = {"proved": "✓", "refuted": "✗", "undecided": "?", "holds": "✓", "fails": "✗", "no design found": "✗",
    "not checked": "·", "invalid": "!", "failed": "!"}  # fmt: skip
STATUS_CLASSES = {
    **dict.fromkeys(("proved", "holds"), "proved"), "undecided": "undecided",
    **dict.fromkeys(("refuted", "fails", "failed", "invalid", "no design found"), "refuted"),
}  # fmt: skip


def status_badge(status: str, *, expected: bool = False) -> str:
    """A status as symbol and word; the colour only repeats them: none where the status is what was expected."""
    symbol, told = SYMBOLS.get(status, "·"), f"{status}, as expected" if expected else status
    kind = "expected" if expected else STATUS_CLASSES.get(status, "")
    return f'<span class="status {kind}">{symbol} {escape(told)}</span>'
