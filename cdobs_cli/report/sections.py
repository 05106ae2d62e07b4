"""What a report says, in order: from the nouns to sections of blocks."""

from __future__ import annotations

from collections.abc import Iterator
from shlex import quote
from typing import Any

from cdobs_cli.certificate import Bound, Claim, Witness
from cdobs_cli.chart import Table
from cdobs_cli.labels import Labels
from cdobs_cli.report import systems
from cdobs_cli.report.accuracy import accuracy
from cdobs_cli.report.blocks import (
    Block,
    Bullets,
    Cell,
    Code,
    Figure,
    Grid,
    Listing,
    Mark,
    Mathematics,
    Paragraph,
    Picture,
    Section,
    Term,
    numbered,
)
from cdobs_cli.report.counterexamples import SAID, in_words, quantity_names
from cdobs_cli.report.front import front_table
from cdobs_cli.report.ladder import Ladder
from cdobs_cli.report.model import Report, bound_title, domain_text
from cdobs_cli.report.numbers import (
    NOTHING,
    about_text,
    departure_sentence,
    end_text,
    ends_text,
    implicit_sentence,
    margin_text,
    number_text,
)
from cdobs_cli.report.references import cited
from cdobs_cli.report.sensing import assumed, gains_table
from cdobs_cli.report.witnesses import witness_name
from cdobs_cli.run import RunSummary
from cdobs_cli.sampling import SamplingLaw

MAX_RUN_ROWS = 20
_SIMULATION_CHARTS = ("states", "typed_states", "error", "bands", "accuracy", "sampling")


def sections(report: Report) -> tuple[Section, ...]:
    """All sections that have something to say."""
    every = (
        _plant(report), _measurement(report), _observer(report), _theorem(report), _claims(report), _bounds(report),
        _witnesses(report), _simulation(report), _exhibits(report), _expectations(report), _reproduce(report),
        _references(report),
    )  # fmt: skip
    return numbered([section for section in every if section.blocks])


def _plant(report: Report) -> Section:
    plant = report.plant
    blocks: list[Block] = [*_typed(report), Mathematics(systems.plant_equations(plant))]
    ranges = ((one.name, one.range) for one in plant.inputs)
    inputs = [f"{name} in [{ends.lower or '−∞'}, {ends.upper or '∞'}]" if ends else name for name, ends in ranges]
    if inputs:
        blocks.append(Paragraph(f"Known inputs: {', '.join(inputs)}."))
    for box, letter, what in ((plant.disturbance, "d", "Disturbance"), (plant.noise, "v", "Measurement noise")):
        if box is not None:
            pairs = enumerate(zip(box.lower, box.upper, strict=True), start=1)
            ends = ", ".join(f"{letter}{i} in [{low}, {up}]" for i, (low, up) in pairs)
            blocks.append(Paragraph(f"{what}: {ends}."))
    if plant.intensity is not None:
        words = f"Disturbance: white, of the intensity Q (the covariance of its integral, per {report.labels.time}):"
        blocks += [Paragraph(words), Mathematics(systems.gain_equations({"Q": plant.intensity}))]
    if plant.covariance is not None:
        words = "Measurement noise: of mean 0 and the covariance R, independent from sample to sample:"
        blocks += [Paragraph(words), Mathematics(systems.gain_equations({"R": plant.covariance}))]
    if report.labels.states:
        told = ", ".join(f"{name} in {unit}" for name, unit in report.labels.states.items())
        blocks.append(Paragraph(f"Units: {told}, time in {report.labels.time}."))
    if report.domain:
        blocks.append(Paragraph(f"Domain: {domain_text(report.domain)}."))
    return Section("Plant", (*blocks, *_slopes(report)))


def _typed(report: Report) -> tuple[Block, ...]:
    """The plant in the user's states, and the coordinates it is brought to."""
    if report.typed is None or report.coordinates is None:
        return ()
    typed, coordinates = report.typed, report.coordinates
    return (
        Paragraph("As typed:"),
        Mathematics((*systems.typed_equations(typed), *(systems.typed_outputs(typed)))),
        Paragraph("In the coordinates"),
        Mathematics(systems.map_equations(coordinates.names, coordinates.map)),
        Paragraph("the plant is"),
    )


def _slopes(report: Report) -> tuple[Block, ...]:
    plant, rows = report.plant, list[tuple[Cell, ...]]()
    for i, j in plant.slopes.entries:
        key = f"{i + 1}.{j + 1}"
        low, up = str(plant.slopes.lower[i, j]), str(plant.slopes.upper[i, j])
        declared = f"[{low}, {up}]"
        if (i, j) in plant.slopes.auto:
            ends = report.design.slopes.get(key)
            low, up = (end_text(ends[0], 8, up=False), end_text(ends[1], 8, up=True)) if ends else (NOTHING, NOTHING)
            declared = f"auto: [{low}, {up}]"
        rows.append(_slope(report, f"∂φ{i + 1}/∂{plant.states[j]}", declared, key))
    rows += _output_slopes(report)
    if not rows:
        return (Paragraph("The plant is linear: no slope is claimed."),)
    where = "on the domain" if report.domain else "everywhere"
    caption = f"Bounds of the nonlinearity's slopes, claimed {where}."
    return (Grid(("slope", "claimed range", "status", "margin"), tuple(rows), "Slopes", caption),)


def _output_slopes(report: Report) -> list[tuple[Cell, ...]]:
    """The slopes of the outputs that vary."""
    rows: list[tuple[Cell, ...]] = []
    for rho in report.plant.output_quantities:
        k, j = rho.entry
        low, up = end_text(str(rho.lower), 8, up=False), end_text(str(rho.upper), 8, up=True)
        what, key = f"∂y{k + 1}/∂{report.plant.states[j]}", f"output.{k + 1}.{j + 1}"
        rows.append(_slope(report, what, f"auto: [{low}, {up}]", key))
    return rows


def _slope(report: Report, what: str, declared: str, key: str) -> tuple[Cell, ...]:
    claim = report.check.claim(f"slopes.{key}") if report.check else None
    status: Cell = Mark(claim.status) if claim else "not checked"
    return what, declared, status, margin_text(claim.margin) if claim else NOTHING


def _measurement(report: Report) -> Section:
    designed, typed = report.design.sampling, report.plant.sampling
    begin = "Sensors are read apart:" if designed.has_sensors else "Samples are taken"
    text = f"{begin} {designed.text(report.labels.time)}."
    if designed != typed and not typed.is_updated:
        text += f" This is the law designed for; the spec asks for samples {typed.text(report.labels.time)} at least."
    blocks: tuple[Block, ...] = (Mathematics(systems.output_equations(report.plant)), Paragraph(text), *assumed(report))
    return Section("Measurement", blocks)


def _observer(report: Report) -> Section:
    design = report.design
    if design.outcome == "none":
        told = Paragraph(f"No design was found. {design.reason or ''}".strip())
        return Section("Observer", (told, *_choice(report)))
    origin = "given in the spec" if design.outcome == "given" else "found by the search"
    blocks: list[Block] = [
        Paragraph(f"Family {report.family.model_dump().get('family', design.family)}; the gain was {origin}.")
    ]
    blocks += _choice(report)
    if report.observer is not None:
        blocks += [Paragraph("Between samples:"), Mathematics(systems.flow_equations(report.observer))]
        if design.sampling.is_on_change:
            for number, one in enumerate(design.sampling.thresholds):
                words = f"When {one.name} sends, as its output is {one.delta} from its prediction:"
                blocks += [
                    Paragraph(words),
                    Mathematics(systems.jump_equations(report.observer, report.plant.p, number)),
                ]
        elif jumps := systems.jump_equations(report.observer, report.plant.p):
            blocks += [Paragraph(_at_a_sample(design.sampling)), Mathematics(jumps)]
        if held := systems.held_equations(report.observer):
            blocks += [Paragraph("Held from one sample to the next:"), Mathematics(held)]
    if design.gain and design.sampling.has_sensors:
        blocks.append(gains_table(report))
    elif design.gain:
        words = "The gain, in the decimals that are run and proved:"
        blocks += [Paragraph(words), Mathematics(systems.gain_equations(design.gain))]
    return Section("Observer", tuple(blocks))


def _at_a_sample(law: SamplingLaw) -> str:
    """Of sensors with periods of their own one sample is written out."""
    if not law.has_sensors:
        return "At a sample:"
    which = "At the first sample, of" if law.is_multirate else "At a sample of"
    return f"{which} {law.readings[0].name}; at the others alike, with what is read then and its gain:"


def _choice(report: Report) -> tuple[Block, ...]:
    """The families that the observer was chosen from."""
    if not report.design.choice:
        return ()
    rows = []
    for one in report.design.choice:
        ends = (end_text(one[name], 6, up=False) for name in ("period", "rate"))
        rows.append((str(one["family"]), str(one["outcome"]), one["verdict"] or NOTHING, *ends, str(one["why"])))
    columns = ("family", "outcome", "verdict", *map(report.labels.axis, ("period (s)", "rate (1/s)")), "why")
    caption = (
        "Each family that takes plant and law was tried with little effort; the best by the objective is designed."
    )
    return (Grid(columns, tuple(rows), "Families", caption),)


def _theorem(report: Report) -> Section:
    blocks: list[Block] = [Paragraph(f"Family after {report.family.source}.")]
    proof = report.proof
    if proof is not None:
        method = f" by the method {proof.method}" if proof.method else ""
        text = f"{_verb(report)} {proof.id}{method}: {_sentence(proof.statement)} Source: {proof.source}."
        blocks.append(Paragraph(text))
    elif report.convergence is not None and report.convergence.by:
        blocks.append(Paragraph(f"{_verb(report)} {report.convergence.by}. Source: {report.convergence.source}."))
    return Section("Theorem", tuple(blocks))


def _verb(report: Report) -> str:
    refuted = report.convergence is not None and report.convergence.status == "refuted"
    return "Convergence is refuted by" if refuted else "Convergence rests on"


def _sentence(text: str) -> str:
    return text if text.endswith((".", "?", "!")) else f"{text}."


def _claims(report: Report) -> Section:
    if report.check is None:
        return Section("Claims", (Paragraph("Nothing has been checked yet."),))
    groups: dict[str, list[Claim]] = {title: [] for title in _GROUPS}
    for claim in sorted(report.check.claims, key=lambda claim: claim.kind):
        groups[_group(claim)].append(claim)
    columns = ("claim", "status", "statement", "margin", "method", "source")
    drawn, blocks = {chart.name for chart in report.charts}, []
    for title, claims in groups.items():
        if claims:
            figures = [_figure_of(claim, drawn) for claim in claims]
            more = ("figure",) if any(figures) else ()
            rows = tuple(
                (*_claim_row(claim), *([Figure(one) if one else NOTHING] if more else []))
                for claim, one in zip(claims, figures, strict=True)
            )
            folded = title != "Required" and bool(groups["Required"])
            blocks.append(Grid((*columns, *more), rows, title, _GROUPS[title], is_folded=folded))
    return Section("Claims", tuple(blocks))


# The figure that shows what a claim is about, by how its id begins; the first that is drawn.
_FIGURES = {
    "convergence": ("error", "bands", "width"), "error_bounded": ("accuracy", "bands", "width"),
    "period": ("periods",), "guaranteed_period": ("periods",), "positivity": ("positivity", "periods"),
    "set.contraction": ("lyapunov",), "enclosure": ("states",),
}  # fmt: skip


def _figure_of(claim: Claim, drawn: set[str]) -> str:
    """The chart's name, empty where there is none."""
    begins = next((names for begin, names in _FIGURES.items() if claim.id.startswith(begin)), ())
    return next((name for name in (witness_name(claim.id), *begins) if name in drawn), "")


_GROUPS = {
    "Required": "These decide the verdict.",
    "Assumptions": "What is taken for granted of the plant where it is not proved; the verdict names it.",
    "Certificates": "Alternatives: one that fails refutes nothing.",
    "Further claims": "",
    "Printed in the paper": "The paper's own data put to the test; the verdict does not depend on them.",
}


def _group(claim: Claim) -> str:
    titles = {"assumption": "Assumptions", "certificate": "Certificates", "printed": "Printed in the paper"}
    return "Required" if claim.required else titles.get(claim.kind, "Further claims")


def _claim_row(claim: Claim) -> tuple[Cell, ...]:
    method = claim.method or (f"by {claim.by}" if claim.by else NOTHING)
    name = Term(claim.id, claim.id, is_code=True)
    return name, Mark(claim.status), claim.statement, margin_text(claim.margin), method, claim.source


def _bounds(report: Report) -> Section:
    blocks: list[Block] = [Picture(chart) for chart in report.charts if isinstance(chart, Ladder)]
    if report.check is not None and report.check.bounds:
        rows = tuple(
            (Term(bound_title(name), name), *ends_text(bound), bound.unit, bound.method or NOTHING, about_text(bound))
            for name, bound in report.check.bounds.items()
        )
        caption = "Proved and refuted ends, rounded to the safe side. Between them nothing is known."
        blocks.append(Grid(("quantity", "proved", "refuted", "unit", "method", "about"), rows, "", caption))
    return Section("Bounds", tuple(blocks))


def _witnesses(report: Report) -> Section:
    blocks: list[Block] = []
    told: dict[str, str] = {}  # one counterexample often defeats several claims
    for claim in report.check.claims if report.check else ():
        if claim.witness is not None:
            first = told.setdefault(repr(claim.witness), claim.id)
            if first != claim.id:
                blocks.append(Paragraph(f"{claim.id}: the same counterexample as {first}."))
                continue
            told_in_words = in_words(claim.witness, report.plant, report.design.sampling, report.labels.time)
            blocks.append(Paragraph(f"{claim.id}: {told_in_words}"))
            if claim.witness.kind != "noise":  # that is a word of hundreds of numbers, for `simulate --witness`
                blocks += _arcs(claim.witness, report)
                blocks += _data(claim.witness)
            blocks += [Picture(chart) for chart in report.charts if chart.name == witness_name(claim.id)]
            if claim.witness.kind in ("constant", "switching", "box", "noise"):
                blocks.append(Listing((f"cdobs simulate {quote(report.spec_path)} --witness {claim.id}",)))
    return Section("Counterexamples", tuple(blocks))


def _data(witness: Witness) -> tuple[Block, ...]:
    """What a family stored with a counterexample, and the words do not say."""
    rows = tuple(_flat("", {name: value for name, value in witness.data.items() if name not in SAID}))
    if not rows:
        return ()
    shown = tuple((name, Code(text)) for name, text in rows[:MAX_RUN_ROWS])
    caption = f"The first {MAX_RUN_ROWS} of {len(rows)}." if len(rows) > MAX_RUN_ROWS else ""
    return (Grid(("quantity", "value"), shown, "", caption),)


def _flat(name: str, value: Any) -> Iterator[tuple[str, str]]:
    """Nested JSON as rows: keys joined by dots, plain lists on one line."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from _flat(f"{name}.{key}" if name else str(key), inner)
    elif isinstance(value, list | tuple) and any(isinstance(inner, dict | list | tuple) for inner in value):
        for index, inner in enumerate(value, start=1):
            yield from _flat(f"{name} {index}", inner)
    elif isinstance(value, list | tuple):
        yield name, ", ".join(number_text(inner, 17) for inner in value)
    else:
        yield name, number_text(value, 17)


def _arcs(witness: Witness, report: Report) -> tuple[Block, ...]:
    """Slopes over time; words tell a single arc."""
    if len(witness.values) <= 1 and witness.kind in ("constant", "switching", "vector"):
        return ()
    if not witness.values:
        return ()
    labels, width = report.labels, max(len(row) for row in witness.values)
    names = list(quantity_names(witness, report.plant))[:width]
    names += [f"value {index + 1}" for index in range(len(names), width)]
    timed = bool(witness.times)
    rows = []
    for index, values in enumerate(witness.values[:MAX_RUN_ROWS]):
        time: tuple[Cell, ...] = (witness.times[index] if index < len(witness.times) else NOTHING,) if timed else ()
        rows.append((str(index + 1), *time, *values, *[NOTHING] * (width - len(values))))
    return (Grid(("arc", *((labels.axis("time (s)"),) if timed else ()), *names), tuple(rows)),)


def _simulation(report: Report) -> Section:
    if report.run is None:
        return Section("Simulation", ())
    if report.design.outcome == "none":
        alone = Paragraph("There is no observer to run: this is the plant by itself.")
        pictures = (Picture(chart) for chart in report.charts if chart.name in _SIMULATION_CHARTS)
        return Section("Simulation", (*_signals(report), alone, *pictures))
    overall, runs = report.run.overall, report.run.summaries
    rows = [_run_row(str(index + 1), summary, report.labels) for index, summary in enumerate(runs[:MAX_RUN_ROWS])]
    if len(runs) > 1:
        rows.append(_run_row("all", overall, report.labels))
    periods = (report.labels.axis(f"{which} period (s)") for which in ("shortest", "longest"))
    columns = ("run", "samples", *periods, "final error", "RMSE", "inclusion margin", "outcome")
    caption = f"The first {MAX_RUN_ROWS} of {len(runs)} runs." if len(runs) > MAX_RUN_ROWS else ""
    blocks: list[Block] = [*_signals(report), Grid(columns, tuple(rows), "", caption)]
    if overall.departure is not None:
        blocks.append(Paragraph(f"{departure_sentence(overall.departure, report.labels)}."))
    if report.run.implicit:
        told = implicit_sentence(report.run.implicit, len(runs))
        blocks.append(Paragraph(f"{told[0].upper()}{told[1:]}."))
    blocks += accuracy(report)
    blocks += [Picture(chart) for chart in report.charts if chart.name in _SIMULATION_CHARTS]
    return Section("Simulation", tuple(blocks))


def _signals(report: Report) -> tuple[Block, ...]:
    """What the inputs are."""
    if not report.signals:
        return ()
    fed = any(signal.variables - {"t"} for signal in report.signals.values())
    words = "The inputs, y being the last measurement:" if fed else "The inputs:"
    return Paragraph(words), Mathematics(systems.signal_equations(report.signals, report.plant.p))


def _with_unit(text: str, state: str, labels: Labels) -> str:
    return f"{text} {labels.states[state]}" if state in labels.states else text


def _run_row(name: str, summary: RunSummary, labels: Labels) -> tuple[Cell, ...]:
    rmse = ", ".join(
        _with_unit(f"{state} {number_text(value, 4)}", state, labels) for state, value in summary.rmse.items()
    )
    rmse = rmse or NOTHING
    ended = "diverged" if summary.diverged else "left the domain" if summary.left_domain else "completed"
    numbers = (summary.period_min, summary.period_max, summary.error_final)
    margin = number_text(summary.inclusion_margin, 4)
    told = tuple(number_text(value) for value in numbers)
    return (name, str(summary.measurements), *told, rmse, margin, summary.stopped or ended)


def _exhibits(report: Report) -> Section:
    blocks: list[Block] = []
    if report.exhibits.notes:
        blocks.append(Bullets(report.exhibits.notes))
    front = front_table(report.design, report.plant.states, late=bool(report.plant.delays))
    if front is not None:
        blocks.append(_table(report.labels.table(front)))
    blocks += [_table(table) for table in report.exhibits.tables]
    elsewhere = {
        *_SIMULATION_CHARTS,
        *(witness_name(claim.id) for claim in (report.check.claims if report.check else ())),
    }
    shown = [chart for chart in report.charts if not isinstance(chart, Ladder) and chart.name not in elsewhere]
    return Section("Details of the design", (*blocks, *(Picture(chart) for chart in shown)))


def _table(table: Table) -> Grid:
    rows = tuple(tuple(text for cell in row for text in _cell_texts(cell)) for row in table.rows)
    return Grid(table.columns, rows, table.title, table.caption)


def _cell_texts(cell: str | float | int | Bound | None) -> tuple[str, ...]:
    return ends_text(cell) if isinstance(cell, Bound) else (number_text(cell),)


def _expectations(report: Report) -> Section:
    marked = ((what, Mark("holds" if holds else "fails"), value) for what, holds, value in report.expectations)
    rows: tuple[tuple[Cell, ...], ...] = tuple(marked)
    return Section("Expectations", (Grid(("expected", "outcome", "found"), rows),) if rows else ())


def _reproduce(report: Report) -> Section:
    blocks: list[Block] = [Listing((f"cdobs run {quote(report.spec_path)}", f"cdobs check {quote(report.spec_path)}"))]
    if report.digests:
        rows: tuple[tuple[Cell, ...], ...] = tuple((name, Code(digest)) for name, digest in report.digests.items())
        blocks.append(Grid(("artefact", "sha256"), rows, "Artefacts", is_folded=True))
    if report.versions:
        versions: tuple[tuple[Cell, ...], ...] = tuple((name, Code(one)) for name, one in report.versions.items())
        blocks.append(Grid(("software", "version"), versions, "Software", is_folded=True))
    solver = report.design.solver
    if solver is not None:
        how = f"{solver.name} {solver.version} ({solver.status}, {solver.iterations} iterations)"
        evidence = "its answer is no evidence: every claim above is proved again from the printed decimals."
        blocks.append(Paragraph(f"The search used {how}; {evidence}"))
    return Section("How to reproduce", tuple(blocks))


def _references(report: Report) -> Section:
    items = tuple(f"{reference.key}: {reference.text}" for reference in cited(report.sources))
    return Section("References", (Bullets(items),) if items else ())
