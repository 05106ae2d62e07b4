"""Labels of units: of time, and of the states. Numbers are never converted, and nothing that is computed reads them.

Whatever is computed says "s"; what is shown says the user's own word for it.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import field, replace

from cdobs_cli.certificate import Bound, Check
from cdobs_cli.chart import Chart, Exhibits, Panel, Table
from cdobs_cli.design import Design
from cdobs_cli.records import dataclass

SECONDS = "s"
OF_STATES = ("error", "error_transient", "rms")  # bounds `name.<state>` in the unit of the state
_NUMBER = r"\d[\d.eE+/-]*(?<![.,])"
# Behind which words a sentence tells a period, or a rate.
_TOLD = (
    "sampling every|sampled every|sampling at periods in|periods in|periods from|periods up to|constant period"
    "|period with a proof is|period found is|period reached is about|T_k =|T_k in|Tbar =|T ="
)
_PERIOD = re.compile(rf"\b((?:{_TOLD}) (?:{_NUMBER}|\[{_NUMBER}, {_NUMBER}\]))(?![\w\[])")
_RATE = re.compile(rf"\b((?:at the rate|keeps the rate|decays at) {_NUMBER})(?![\w\[])")


@dataclass(frozen=True)
class Labels:
    """time: of every time; 1/time of rates. states: by name, of those that have one."""

    time: str = SECONDS
    states: Mapping[str, str] = field(default_factory=dict)

    def unit(self, unit: str, known: str = SECONDS) -> str:
        """A unit in which `known` stands for the unit of time."""
        return {known: self.time, f"1/{known}": f"1/{self.time}"}.get(unit, unit)

    def axis(self, label: str) -> str:
        """`time (s)`, `proved rate (1/s)`, `time since the sample (s)`."""
        return label.replace("(s)", f"({self.time})").replace("(1/s)", f"(1/{self.time})")

    def sentence(self, text: str) -> str:
        """A sentence with the unit behind each period and rate, where the user gave one."""
        if self.time == SECONDS:
            return text
        return _RATE.sub(rf"\1 1/{self.time}", _PERIOD.sub(rf"\1 {self.time}", text))

    def bounds(self, check: Check) -> Check:
        """The bounds in the unit of time, from whatever unit they were in."""
        known = check.time_unit or SECONDS
        bounds = {name: replace(one, unit=self._of_bound(name, one, known)) for name, one in check.bounds.items()}
        return replace(check, bounds=bounds, time_unit="" if self.time == SECONDS else self.time)

    def _of_bound(self, name: str, bound: Bound, known: str) -> str:
        """Of an error's bound the unit of its state."""
        head, _, state = name.partition(".")
        return self.states.get(state, "") if head in OF_STATES else self.unit(bound.unit, known)

    def check(self, check: Check) -> Check:
        """As it is shown: bounds, sentences, and what bounds are about."""
        shown = self.bounds(check)
        bounds = {
            name: one if one.about is None else replace(one, about=self.sentence(one.about))
            for name, one in shown.bounds.items()
        }
        claims = tuple(replace(one, statement=self.sentence(one.statement)) for one in check.claims)
        return replace(shown, claims=claims, bounds=bounds)

    def design(self, design: Design) -> Design:
        """As it is shown: its reason."""
        return design if design.reason is None else replace(design, reason=self.sentence(design.reason))

    def exhibits(self, exhibits: Exhibits, axes: Mapping[str, str]) -> Exhibits:
        """What a family adds, as it is shown."""
        charts = tuple(self.chart(one, axes) for one in exhibits.charts)
        tables = tuple(self.table(one) for one in exhibits.tables)
        return Exhibits(charts, tables, tuple(self.sentence(one) for one in exhibits.notes))

    def chart(self, chart: Chart, axes: Mapping[str, str] | None = None) -> Chart:
        """Its axes; `axes`: the state that an axis is of, by its label."""
        return replace(chart, panels=tuple(self._panel(one, axes or {}) for one in chart.panels))

    def _panel(self, panel: Panel, axes: Mapping[str, str]) -> Panel:
        state = axes.get(panel.y_label, "")
        unit = f" ({self.states[state]})" if state in self.states else ""
        return replace(panel, x_label=self.axis(panel.x_label), y_label=self.axis(panel.y_label) + unit)

    def table(self, table: Table) -> Table:
        """Its columns, and bounds among its cells."""
        rows = tuple(tuple(self._cell(cell) for cell in row) for row in table.rows)
        return replace(table, columns=tuple(self.axis(one) for one in table.columns), rows=rows)

    def _cell(self, cell: str | float | int | Bound | None) -> str | float | int | Bound | None:
        return replace(cell, unit=self.unit(cell.unit)) if isinstance(cell, Bound) else cell
