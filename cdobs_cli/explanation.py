"""`cdobs explain`: the list of ids, the page of one, and what the stored artefacts of a spec say of it."""

from __future__ import annotations

import shutil
import sys
from collections.abc import Iterator
from dataclasses import field
from os.path import exists
from pathlib import Path
from shlex import quote
from textwrap import fill
from typing import TYPE_CHECKING, Any

from cdobs_cli.errors import ArtefactError, CdobsError, UsageError
from cdobs_cli.explain.pages import KINDS, Page, find, nearest, pages
from cdobs_cli.outcome import readable
from cdobs_cli.printable import lines, printable
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.certificate import Bound, Check, Claim
    from cdobs_cli.pipeline import Work
    from cdobs_cli.spec.model import Spec
    from cdobs_cli.store import Store

_WIDEST = 100  # columns of a paragraph
_NARROWEST = 40
_COLUMN = 30  # of the ids in the list
_EFFORTS = (1, 0, 2, 3)
_SPECS = (".yaml", ".yml")
_PATHS = ("check.", "claims.", "bounds.")  # what `expect` writes before an id
_ENDS = (".status", ".proved", ".refuted", ".margin")  # and behind it
_RUNS = ("constant", "switching", "box", "noise")  # kinds of witnesses that are runs


@dataclass(frozen=True)
class Stored:
    """What the results of a spec say of an id.

    verdict: of the spec. note: why there is nothing to say, or how what is told belongs to the id.
    """

    spec: str
    folder: str
    verdict: str | None = None
    outcome: str | None = None
    claims: tuple[Claim, ...] = ()
    bounds: dict[str, Bound] = field(default_factory=dict)
    note: str | None = None

    def document(self) -> dict[str, Any]:
        return {
            "spec": self.spec, "folder": self.folder, "verdict": self.verdict, "outcome": self.outcome,
            "claims": [claim.document() for claim in self.claims],
            "bounds": {name: bound.document() for name, bound in self.bounds.items()}, "note": self.note,
        }  # fmt: skip


def explained(identifier: str) -> tuple[str, Page]:
    """The id as the pages know it, and its page; `bounds.period_max.proved`, as `expect` writes it, is `period_max`.

    Raises:
        UsageError: no page is about it; what may have been meant is named.
    """
    page = find(identifier)
    if page is not None:
        return identifier, page
    if identifier.endswith(_SPECS) or exists(identifier):
        told = f"{identifier} is a path, and what to explain comes before it"
        raise UsageError(f"{told}: `cdobs explain convergence {quote(identifier)}`; `cdobs explain` lists all ids")
    bare = identifier
    for begin in _PATHS:
        bare = bare.removeprefix(begin)
    for end in _ENDS:
        bare = bare.removesuffix(end)
    page = find(bare)
    if page is None:
        near = ", ".join(nearest(identifier))
        told = f"; near it: {near}" if near else ""
        raise UsageError(f"nothing is known of {identifier!r}{told}; `cdobs explain` lists all ids")
    return bare, page


def stored(identifier: str, page: Page, path: Path, out: Path) -> Stored:
    """What the artefacts of a spec say of an id, or why they say nothing. Nothing is computed anew.

    Raises:
        UsageError: the path is a directory.
        SpecError: it is no spec.
    """
    from cdobs_cli.batch import jobs
    from cdobs_cli.spec.model import load
    from cdobs_cli.store import Store

    if path.is_dir():
        raise UsageError(f"{path} is a directory; `cdobs explain ID SPEC` takes one spec")
    (job,) = jobs([path], out, writing=False)
    spec, store = load(path), Store(job.folder)
    names = readable(str(path)), readable(str(job.folder))
    try:
        work = _current(spec, store)
    except ArtefactError as error:
        make = f"`cdobs check {quote(str(path))} --out {quote(str(out))}`"
        return Stored(*names, note=f"{error}: {make}; if results are elsewhere, --out says where")
    assert work.check is not None and work.design is not None
    check = work.spec.labels.check(work.check)
    claims, bounds, note = _about(identifier, page, check)
    return Stored(*names, check.verdict, work.design.outcome, claims, bounds, note)


def _current(spec: Spec, store: Store) -> Work:
    """The artefacts of this spec, of whatever effort they are.

    Raises:
        ArtefactError: there are none, or what is there was edited or damaged, or is of another spec.
    """
    from cdobs_cli.pipeline import Work, take_stored

    design = store.design()
    key = None if design is None else design.digests.get("key")
    works = (Work(spec, store, effort) for effort in _EFFORTS)
    work = next((work for work in works if work.design_key == key), Work(spec, store))
    try:
        take_stored(work)
    except CdobsError:
        raise
    except Exception as error:  # sealed, and yet not what any command wrote
        told = f"{store.folder}: its artefacts cannot be shown ({type(error).__name__}: {error})"
        raise ArtefactError(told) from error
    return work


def _about(identifier: str, page: Page, check: Check) -> tuple[tuple[Claim, ...], dict[str, Bound], str | None]:
    """The claims and bounds of this very id, else all that its page is about, by id, method, status, kind or witness;
    and a note where an id was asked for that is not there."""
    claims = tuple(claim for claim in check.claims if claim.id == identifier)
    bounds = {name: bound for name, bound in check.bounds.items() if name == identifier}
    if claims or bounds:
        return claims, bounds, None
    claims = tuple(claim for claim in check.claims if _concerns(page, claim))
    bounds = {name: one for name, one in check.bounds.items() if find(name) is page or one.method in page.ids}
    if not claims and not bounds:
        return (), {}, "nothing there is about it"
    return claims, bounds, None if identifier in page.ids else f"there is no {identifier}; of the same kind are"


def _concerns(page: Page, claim: Claim) -> bool:
    kinds = {claim.method, claim.status, claim.kind, *(("required",) if claim.required else ())}
    if claim.witness is not None:
        kinds |= {claim.witness.kind, claim.witness.about, "witness"}
    return find(claim.id) is page or bool(kinds & set(page.ids))


# ---------------------------------------------------------------- text


def list_text() -> str:
    """All ids by kind, a line each; further ids of a page name its first."""
    width = _width() if sys.stdout.isatty() else 10_000
    told = ["`cdobs explain ID` explains one, `cdobs explain ID SPEC` also tells what the results of a spec say of it."]
    for kind, title in KINDS.items():
        told += ["", title]
        for page in (page for page in pages() if kind in page.kinds):
            # Of what is proved the ids of artefacts, not the ways of proof that share their page.
            first, *further = (one for one in page.ids if kind not in ("claim", "bound") or " " not in one)
            sentences = {first: page.first_sentence} | dict.fromkeys(further, f"see {first}")
            told += [_cut(f"  {one:{_COLUMN}}  {sentence}", width) for one, sentence in sentences.items()]
    return lines("\n".join(told))


def _cut(text: str, width: int) -> str:
    return text if len(text) <= width else f"{text[: width - 2]}.."


def page_text(identifier: str, page: Page, said: Stored | None) -> str:
    """A page for reading, and what is stored of it."""
    heading = identifier if identifier in page.ids else f"{identifier}  ({', '.join(page.ids)})"
    told = [f"{heading}  [{', '.join(page.kinds)}]"]
    for title, text in page.parts:
        told += ["", _filled(f"{title}. {text}")]
    others = [one for one in page.ids if one != identifier]
    if others and identifier in page.ids:
        told += ["", _filled(f"The same page: {', '.join(others)}.")]
    if said is not None:
        told += ["", *_stored_lines(said)]
    return lines("\n".join(told))


def _stored_lines(said: Stored) -> Iterator[str]:
    verdict = "" if said.verdict is None else f", verdict {said.verdict}, gain {said.outcome}"
    yield _filled(f"In the results of {said.spec} ({said.folder}{verdict}):")
    if said.note is not None:
        yield _filled(f"{said.note}{':' if said.claims or said.bounds else ''}", 2)
    for claim in said.claims:
        yield from _claim_lines(said.spec, claim)
    for name, bound in said.bounds.items():
        yield _filled(_bound_text(name, bound), 2)


def _claim_lines(spec: str, claim: Claim) -> Iterator[str]:
    from cdobs_cli.report.numbers import margin_text

    kind = f"{claim.kind}, required" if claim.required else claim.kind
    yield _filled(f"{claim.id}: {claim.status} ({kind})", 2)
    yield _filled(claim.statement, 6)
    told = [f"margin {margin_text(claim.margin)}"] if claim.margin is not None else []
    told += [f"method {claim.method}"] if claim.method is not None else []
    told += [f"rests on {claim.by}"] if claim.by is not None else []
    told.append(f"source: {claim.source}")
    yield _filled("; ".join(told), 6)
    if claim.witness is not None:
        told = [f"witness of kind {claim.witness.kind}, about the {claim.witness.about}"]
        if claim.witness.kind in _RUNS:
            told.append(f"cdobs simulate {quote(spec)} --witness {claim.id}")
        yield _filled(": ".join(told), 6)


def _bound_text(name: str, bound: Bound) -> str:
    from cdobs_cli.report.numbers import NOTHING, about_text, ends_text, unit_text

    proved, refuted = (end if end == NOTHING else f"{end}{unit_text(bound)}" for end in ends_text(bound))
    by = "" if bound.method is None else f", by {bound.method}"
    about = "" if bound.about is None else f" ({about_text(bound)})"
    return f"{name}: proved {proved}, refuted {refuted}{by}{about}; {bound.better} is better"


def _width() -> int:
    return max(_NARROWEST, min(_WIDEST, shutil.get_terminal_size().columns))


def _filled(text: str, indent: int = 0) -> str:
    """Wrapped to the terminal's width. What comes from files is made printable first, so that it stays one
    paragraph."""
    begin = " " * indent
    return fill(
        printable(text), _width(), initial_indent=begin, subsequent_indent=begin,
        break_long_words=False, break_on_hyphens=False,
    )  # fmt: skip
