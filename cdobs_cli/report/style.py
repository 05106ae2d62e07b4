"""The look of the HTML pages: one style sheet, inline, for screens of any width, dark or light, and for print."""

from __future__ import annotations

from base64 import b64encode
from hashlib import sha256

from cdobs_cli import printable

STYLE = """
:root { color-scheme: light dark; --ink: #1b1f24; --soft: #57606a; --line: #d5dbe1; --paper: #ffffff; --panel: #f5f7f9;
  --proved: #00694c; --proved-bg: #e0f4ec; --refuted: #a33f00; --refuted-bg: #fdeadd; --undecided: #5c4b00; --undecided-bg: #faf3cf; }
@media (prefers-color-scheme: dark) { :root { --ink: #e4e8ec; --soft: #a3adb8; --line: #3b434c; --paper: #14181c; --panel: #1d2329;
  --proved: #5fd3ab; --proved-bg: #0f3328; --refuted: #ffa56b; --refuted-bg: #43200b; --undecided: #ecd97a; --undecided-bg: #38310c; } }
* { box-sizing: border-box; }
html { -webkit-text-size-adjust: 100%; }
body { margin: 0; background: var(--paper); color: var(--ink); font: 16px/1.5 system-ui, -apple-system, "Segoe UI", sans-serif; }
main { max-width: 66rem; margin: 0 auto; padding: 1.25rem 1rem 3rem; overflow-wrap: break-word; }
main.wide { max-width: 80rem; }
h1 { font-size: 1.6rem; line-height: 1.25; margin: .5rem 0 1rem; }
h2 { font-size: 1.2rem; margin: 2.25rem 0 .6rem; padding-bottom: .2rem; border-bottom: 1px solid var(--line); }
h3 { font-size: 1rem; margin: 1.2rem 0 .3rem; }
p, ul { margin: .5rem 0; }
ul { padding-left: 1.2rem; }
a { color: inherit; }
code, pre { font: .86em/1.45 ui-monospace, "SFMono-Regular", Consolas, "Liberation Mono", monospace; }
pre { background: var(--panel); border: 1px solid var(--line); border-radius: .3rem; padding: .6rem .8rem; overflow-x: auto; }
.headline { border-left: .4rem solid var(--soft); background: var(--panel); padding: .7rem 1rem; border-radius: .2rem; }
.headline.proved { border-color: var(--proved); background: var(--proved-bg); }
.headline.refuted { border-color: var(--refuted); background: var(--refuted-bg); }
.headline.undecided { border-color: var(--undecided); background: var(--undecided-bg); }
.headline p { margin: .25rem 0; }
.verdict { font-size: 1.15rem; font-weight: 700; }
.status { white-space: nowrap; font-weight: 600; font-size: .86em; padding: .05rem .4rem; border-radius: .25rem;
  border: 1px solid currentColor; }
.proved > .verdict, .status.proved { color: var(--proved); }
.refuted > .verdict, .status.refuted { color: var(--refuted); }
.undecided > .verdict, .status.undecided { color: var(--undecided); }
.soft, figcaption, .caption { color: var(--soft); font-size: .9rem; }
.scroll { overflow-x: auto; margin: .6rem 0; }
table { border-collapse: collapse; font-size: .9rem; min-width: 50%; }
caption { text-align: left; font-weight: 600; padding: .2rem 0; }
th, td { text-align: left; vertical-align: top; padding: .3rem .7rem .3rem 0; border-bottom: 1px solid var(--line); overflow-wrap: normal; }
th { font-weight: 600; color: var(--soft); }
td.number { font-variant-numeric: tabular-nums; white-space: nowrap; }
td code { word-break: break-all; }
td.name code { word-break: normal; }
td.long { min-width: 14rem; }
.formula { overflow-x: auto; padding: .2rem 0; }
math { font: 1.12em math, "STIX Two Math", "Cambria Math", "Latin Modern Math", "DejaVu Math TeX Gyre", serif; }
mrow.matrix { display: inline-block math; padding: 0 .25em; margin: 0 .15em; border: solid currentColor; border-width: 0 1px;
  --hook: linear-gradient(currentColor, currentColor);
  background: var(--hook) 0 0 / .3em 1px no-repeat, var(--hook) 100% 0 / .3em 1px no-repeat,
    var(--hook) 0 100% / .3em 1px no-repeat, var(--hook) 100% 100% / .3em 1px no-repeat; }
mrow.matrix mtd { padding: .15em .4em; }
mtable.aligned > mtr > mtd { padding: .3em .15em; text-align: left; math-style: normal; }
mtable.aligned > mtr > mtd:first-child { text-align: right; }
figure { margin: 1rem 0; }
figure .sheet { background: #ffffff; border-radius: .3rem; padding: .25rem; }
figure svg, figure img { display: block; width: 100%; max-width: 46rem; height: auto; margin: 0 auto; }
figcaption { margin-top: .3rem; }
th button { all: unset; cursor: pointer; color: inherit; font: inherit; }
th button:focus-visible { outline: 2px solid currentColor; outline-offset: 2px; }
th button::after { content: " \\2195"; opacity: .5; }
th[aria-sort=ascending] button::after { content: " \\2191"; opacity: 1; }
th[aria-sort=descending] button::after { content: " \\2193"; opacity: 1; }
table.index { width: 100%; }
table.index td { vertical-align: middle; }
table.index img { width: 9rem; height: auto; background: #ffffff; border-radius: .25rem; display: block; }
svg.bracket { width: 9rem; height: 1.6rem; display: block; }
@media (max-width: 44rem) {
  table.index thead, table.index, table.index tbody, table.index tr, table.index td { display: block; }
  table.index thead tr { border: 0; padding: 0; margin: 0 0 .5rem; }
  table.index th { display: inline-block; border: 0; padding: .2rem .8rem .2rem 0; }
  table.index th:last-child { display: none; }
  table.index tbody tr { border: 1px solid var(--line); border-radius: .4rem; padding: .6rem .8rem; margin: 0 0 .8rem; }
  table.index td { border: 0; padding: .15rem 0; }
  table.index td:empty { display: none; }
  table.index img { width: 100%; max-width: 22rem; }
}
@media screen and (max-width: 44rem) {
  table.cards thead { display: none; }
  table.cards, table.cards tbody, table.cards tr, table.cards td { display: block; }
  table.cards tr { border: 1px solid var(--line); border-radius: .4rem; padding: .4rem .7rem; margin: 0 0 .6rem; }
  table.cards td { border: 0; padding: .1rem 0; white-space: normal; }
  table.cards td.none { display: none; }
  table.cards td::before { content: attr(data-label) ": "; color: var(--soft); }
}
@media print {
  :root { color-scheme: light; --ink: #000; --soft: #444; --line: #bbb; --paper: #fff; --panel: #fff; --proved: #00523b; --proved-bg: #fff;
    --refuted: #8a3500; --refuted-bg: #fff; --undecided: #4d3f00; --undecided-bg: #fff; }
  body { font-size: 10.5pt; }
  main, main.wide { max-width: none; padding: 0; }
  .scroll, .formula, pre { overflow: visible; }
  pre { white-space: pre-wrap; }
  table { font-size: 8.5pt; }
  table .soft { font-size: inherit; }
  figure, tr, .headline { break-inside: avoid; }
  h2, h3 { break-after: avoid; }
  th button::after { content: ""; }
  .screen { display: none; }
}
"""


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
