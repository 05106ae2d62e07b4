"""The look of the HTML pages: one style sheet, inline, for screens of any width, dark or light, and for print."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256
from importlib.resources import files

from cdobs_cli import printable
from cdobs_cli.report.palette import variables

STYLE = f"""\
:root {{ {variables(dark=False)} }}
@media screen and (prefers-color-scheme: dark) {{ :root {{ {variables(dark=True)} }} }}
{files("cdobs_cli.report").joinpath("style.css").read_text(encoding="utf-8")}"""


def page(title: str, body: str, *, wide: bool = False, script: str = "", images: str = "data:") -> str:
    """A whole HTML page; `title` and `body` are escaped already. Nothing is fetched but `images` (sources of a
    Content-Security-Policy), and nothing is run but `script`."""
    width = ' class="wide"' if wide else ""
    code = f"<script>{script}</script>\n" if script else ""
    return printable.page(
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{policy(script, images)}">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<link rel="icon" href="data:,">\n<title>{title}</title>\n<style>{STYLE}</style>\n</head>\n'
        f"<body>\n<main{width}>\n{body}\n</main>\n{code}</body>\n</html>\n"
    )


def policy(script: str, images: str) -> str:
    """The Content-Security-Policy of a page: its own styles (figures have some on every element), this one script."""
    scripts = f" script-src {source_hash(script)};" if script else ""
    fetched = f"default-src 'none'; style-src 'unsafe-inline'; img-src {images};{scripts}"
    return f"{fetched} base-uri 'none'; form-action 'none'"


def source_hash(script: str) -> str:
    """How a policy names a script: by its digest."""
    return f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'"
