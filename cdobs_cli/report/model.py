"""The report of one spec as a noun."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import field
from functools import cached_property
from typing import TYPE_CHECKING

from cdobs_cli.certificate import CONVERGENCE, Bound, Check, Claim, Status
from cdobs_cli.chart import Chart, Exhibits
from cdobs_cli.design import Design
from cdobs_cli.labels import Labels
from cdobs_cli.plant import Domain, Plant, TypedDynamics
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.coordinates import Coordinates
    from cdobs_cli.exact.expression import Expression
    from cdobs_cli.families.base import Family
    from cdobs_cli.hybrid import Observer
    from cdobs_cli.report.ladder import Ladder
    from cdobs_cli.run import Run

BOUND_TITLES = {
    "period_max": "Largest sampling period, this gain",
    "period_max_any_gain": "Largest sampling period, any gain",
    "guaranteed_period": "Guaranteed sampling period",
    "positivity_period_max": "Largest period that keeps the bounds ordered",
    "tau_max": "Largest period by the printed theorem",
    "delta_star": "Limit of the reachable set, δ*",
    "delay_max": "Largest delay of measurements",
    "decay_rate": "Decay rate of the error",
    "final_width": "Final width of the interval",
    "error": "Error in the long run, at most",
    "error_transient": "Error on the way, at most",
    "rms": "Root mean square error, at most",
}
# The bracket of the headline: the first of these that is known.
HEADLINE_BOUNDS = ("period_max", "guaranteed_period", "positivity_period_max", "tau_max", "period_max_any_gain")
_PACKAGES = ("numpy", "scipy", "python-flint", "clarabel", "pydantic", "matplotlib")


def bound_title(name: str) -> str:
    """`period_max.clock` is "Largest sampling period, this gain: clock"."""
    head, _, method = name.partition(".")
    words = head.replace("_", " ")
    if head.endswith("_period_max"):
        words = f"Largest sampling period, {head.removesuffix('_period_max').replace('_', ' ')}"
    title = BOUND_TITLES.get(head, words[:1].upper() + words[1:])
    return f"{title}: {method.replace('_', ' ')}" if method else title


# ---------------------------------------------------------------- the report


@dataclass(frozen=True)
class Report:
    """Everything that a report says, assembled and not yet written.

    expectations: (what was expected, whether it holds, what was found). signals: of the inputs in the simulation.
    formats: of the figures. What
    is costly (exhibits, charts, equations, versions) is made when first asked for: a terminal's summary needs none of
    it.
    """

    name: str
    title: str
    spec_path: str
    plant: Plant
    family: Family
    design: Design
    check: Check | None
    run: Run | None = None
    typed: TypedDynamics | None = None
    coordinates: Coordinates | None = None
    expectations: tuple[tuple[str, bool, str], ...] = ()
    digests: Mapping[str, str] = field(default_factory=dict)
    signals: Mapping[str, Expression] = field(default_factory=dict)
    labels: Labels = field(default_factory=Labels)
    formats: tuple[str, ...] = ("svg",)

    @cached_property
    def exhibits(self) -> Exhibits:
        """What the family adds."""
        if self.design.outcome == "none":
            return Exhibits()
        exhibits = self.family.exhibits(self.plant, self.design, self.check, self.run)
        return self.labels.exhibits(exhibits, self._axes)

    @cached_property
    def observer(self) -> Observer | None:
        """The observer's equations, where there is a design."""
        return None if self.design.outcome == "none" else self.family.observer_as_run(self.plant, self.design)

    @cached_property
    def charts(self) -> tuple[Chart | Ladder, ...]:
        """Bracket, counterexamples, simulation, family; a family's chart takes the place of another of its name."""
        from cdobs_cli.report.front import front_charts
        from cdobs_cli.report.ladder import period_ladder
        from cdobs_cli.report.witnesses import witness_charts

        ladder = period_ladder(self.check.bounds) if self.check else None
        common: list[Chart | Ladder] = [ladder] if ladder else []
        if self.check is not None:
            common += [self.labels.chart(one) for one in witness_charts(self.check)]
        common += self.run_charts
        front = front_charts(self.design, self.plant.states, late=bool(self.plant.delays))
        common += [self.labels.chart(one, self._axes) for one in front]
        own = {chart.name for chart in self.exhibits.charts}
        return (*(chart for chart in common if chart.name not in own), *self.exhibits.charts)

    @cached_property
    def run_charts(self) -> tuple[Chart, ...]:
        """The common charts of the simulation, that of the error with its proved envelope."""
        from cdobs_cli.report.trajectories import run_charts

        if self.run is None:
            return ()
        checked = self.check if self.design.outcome != "none" else None
        envelope = None if checked is None else checked.envelope
        bounds = {} if checked is None else checked.bounds
        charts = run_charts(self.plant, self.run, envelope, self.coordinates, bounds, self.design.sampling)
        return tuple(self.labels.chart(one, self._axes) for one in charts)

    @property
    def _axes(self) -> dict[str, str]:
        """The states that axes are of, by what stands there."""
        from cdobs_cli.report.trajectories import axis_name, error_label

        axes: dict[str, str] = {}
        for name in self.labels.states:
            shown = axis_name(name)
            labels = (shown, name, f"width of {name}", f"error of {shown}", error_label(name))
            axes |= dict.fromkeys(labels, name)
        for k, row in enumerate(self.plant.C.rows if self.plant.h is None else ()):
            used = [(name, str(value)) for name, value in zip(self.plant.states, row, strict=True) if str(value) != "0"]
            if len(used) == 1 and used[0][1] == "1" and used[0][0] in self.labels.states:
                y, r = (f"${letter}_{{{k + 1}}}" for letter in "yr")
                axes |= dict.fromkeys((f"{y}$", f"{y}(t_k)$", f"{r}(t_k)$"), used[0][0])
        return axes

    @cached_property
    def versions(self) -> dict[str, str]:
        """Of this tool, of Python, and of the packages that numbers depend on."""
        import platform
        from importlib.metadata import PackageNotFoundError, version

        from cdobs_cli import __version__

        versions = {"cdobs": __version__, "python": platform.python_version()}
        for package in _PACKAGES:
            with suppress(PackageNotFoundError):
                versions[package] = version(package)
        return versions

    @property
    def status(self) -> Status | None:
        """The verdict; None where nothing was checked."""
        return self.check.verdict if self.check else None

    @property
    def verdict(self) -> str:
        """The verdict in a word or three."""
        if self.design.outcome == "none":
            return "no design found"
        return self.status or "not checked"

    @property
    def sentence(self) -> str:
        """What the verdict is about."""
        if self.design.outcome == "none":
            return self.design.reason or "The search gave no reason."
        claim = self.convergence
        return claim.statement if claim else "The design has not been checked."

    @property
    def convergence(self) -> Claim | None:
        """The one consequence that is required."""
        return self.check.claim(CONVERGENCE) if self.check else None

    @property
    def proof(self) -> Claim | None:
        """The certificate that the consequence names."""
        claim = self.convergence
        if self.check is None or claim is None or claim.by is None:
            return None
        return self.check.claim(claim.by)

    @property
    def headline_bound(self) -> tuple[str, Bound] | None:
        """The bracket of the headline: of the period where one is known."""
        if self.check is None:
            return None
        bounds = self.check.bounds.items()
        known = {name: bound for name, bound in bounds if bound.proved is not None or bound.refuted is not None}
        name = next((name for name in (*HEADLINE_BOUNDS, *known) if name in known), None)
        return None if name is None else (name, known[name])

    @property
    def conditions(self) -> tuple[str, ...]:
        """What the headline takes for granted."""
        conditions = []
        if self.design.outcome == "short" and self.status == "proved" and self.design.reason:
            conditions.append(f"Short of what was asked: {self.design.reason}.")
        if self.domain and self.design.estimate.way != "everywhere":
            conditions.append(self._assumption)
        name = self.headline_bound[0] if self.headline_bound else None
        if self.status == "proved" and name == "period_max" and self.design.sampling.is_periodic:
            conditions.append("The period is constant; a smaller constant period is not implied by a larger one.")
        return tuple(conditions)

    @property
    def domain(self) -> Domain:
        """Where the slopes are claimed, in the states that the user typed."""
        return self.typed.domain if self.typed else self.plant.domain

    @property
    def _assumption(self) -> str:
        """What is taken for granted of the plant, and what is known of that."""
        claim = self.check.claim("domain_invariant") if self.check else None
        stays = f"the plant stays in {domain_text(self.domain)}"
        if claim is None or claim.status == "undecided":
            return f"Assumed: {stays}."
        if claim.status == "proved":
            return f"Proved: {stays} once it is there."
        return f"Assumed: {stays}. It can leave: {claim.statement.rpartition(': ')[2]}."

    @property
    def sources(self) -> tuple[str, ...]:
        """Every source that is named."""
        claims = self.check.claims if self.check else ()
        notes = (*self.exhibits.notes, *(table.caption for table in self.exhibits.tables))
        expected = (what for what, _, _ in self.expectations)
        return (self.family.source, self.title, *(claim.source for claim in claims), *notes, *expected)


def domain_text(domain: Domain) -> str:
    """The domain in one line: `0 ≤ x1 ≤ 1, x2 ≤ x1`."""
    parts = []
    for name, interval in domain.box.items():
        low = f"{interval.lower} ≤ " if interval.lower is not None else ""
        high = f" ≤ {interval.upper}" if interval.upper is not None else ""
        parts.append(f"{low}{name}{high}")
    return ", ".join((*parts, *(f"{expression} ≥ 0" for expression in domain.where)))
