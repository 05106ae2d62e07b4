"""The few lines of a spec that a terminal gets; made without what a page needs."""

from __future__ import annotations

from collections import Counter

from cdobs_cli.certificate import Bound, Status
from cdobs_cli.delays import arrival_words
from cdobs_cli.labels import OF_STATES
from cdobs_cli.report.model import Report
from cdobs_cli.report.numbers import ends_text, margin_text, unit_text
from cdobs_cli.report.verdict import verdict_text, words

MAX_LISTED = 12


def ends_sentence(bound: Bound) -> str:
    """`proved 1.713 s, refuted 1.7131 s`, whichever is known."""
    proved, refuted = ends_text(bound)
    ends = []
    if bound.proved is not None:
        ends.append(f"proved {proved}{unit_text(bound)}")
    if bound.refuted is not None:
        ends.append(f"refuted {refuted}{unit_text(bound)}")
    return ", ".join(ends)


def summary_lines(report: Report) -> list[str]:
    """A few plain lines: the verdict in words, then law, brackets, what failed. Status words stand first, so that a
    terminal can colour them."""
    lines = [f"{report.name}: {verdict_text(report)}", *(f"  {sentence}" for sentence in words(report))]
    for one in report.design.choice:
        if one["family"] == report.design.family:
            lines.append(f"  family: {one['family']} ({one['why']})")
    lines.append(f"  sampling: {report.design.sampling.text(report.labels.time)}")
    if late := arrival_words(report.plant.delays, report.labels.time):
        lines.append(f"  late: {late}")
    for name, bound in report.check.bounds.items() if report.check else ():
        if ("." not in name or name.partition(".")[0] in OF_STATES) and (
            bound.proved is not None or bound.refuted is not None
        ):
            method = f" (by {bound.method})" if bound.method else ""
            lines.append(f"  {name}: {ends_sentence(bound)}{method}")
    lines += _claim_lines(report)
    lines += [
        f"  {'holds' if holds else 'fails'} expect {what}: {value}"
        for what, holds, value in report.expectations
        if not holds
    ]
    return lines


def headline(report: Report) -> str:
    """One line: the verdict, and the bracket where one is known."""
    if report.headline_bound is None:
        return verdict_text(report)
    name, bound = report.headline_bound
    return f"{verdict_text(report)}; {name}: {ends_sentence(bound)}"


def _claim_lines(report: Report) -> list[str]:
    if report.check is None:
        return []
    counts = Counter(claim.status for claim in report.check.claims)
    order: tuple[Status, ...] = ("proved", "refuted", "undecided")
    lines = ["  claims: " + ", ".join(f"{counts[status]} {status}" for status in order if counts[status])]
    open_claims = [claim for claim in report.check.claims if claim.status != "proved"]
    for claim in open_claims[:MAX_LISTED]:
        margin = f" (margin {margin_text(claim.margin)})" if claim.margin is not None else ""
        lines.append(f"  {claim.status} {claim.id}: {' '.join(claim.statement.split())}{margin}")
    if len(open_claims) > MAX_LISTED:
        lines.append(f"  and {len(open_claims) - MAX_LISTED} more")
    return lines
