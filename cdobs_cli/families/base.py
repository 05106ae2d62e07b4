"""The one seam: what an observer family is. A family object is its YAML block.

A family knows the Plant, not the spec file; it reads nothing and writes nothing.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from importlib.resources import files
from typing import TYPE_CHECKING, ClassVar, Literal, Self

from pydantic import BaseModel, ConfigDict

from cdobs_cli.errors import Problem

if TYPE_CHECKING:
    from cdobs_cli.bounds.estimate import Transient
    from cdobs_cli.certificate import Certificate, Check
    from cdobs_cli.chart import Exhibits
    from cdobs_cli.design import Confinement, Design
    from cdobs_cli.exact.numbers import ExactMatrix
    from cdobs_cli.hybrid import HybridInclusion, Observer
    from cdobs_cli.plant import Box, Plant
    from cdobs_cli.run import Run, SimulationPlan


class Family(BaseModel, ABC):
    """Base of the observer families: parameters as fields, the verbs as methods.

    Subclasses have `family: Literal["name"] = "name"` and `objective: Literal[..]`, its default first.
    `example.yaml` beside the card is the commented spec that `cdobs init` prints: it runs as it is.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, defer_build=True)

    source: ClassVar[str]
    # Whether convergence is claimed under the declared disturbance and noise (bounds hold), or without them.
    disturbed: ClassVar[bool] = False
    # Whether samples of a constant period may be lost.
    takes_losses: ClassVar[bool] = False
    # Whether sensors may have periods and offsets of their own.
    takes_sensors: ClassVar[bool] = False
    # Whether measurements may arrive late: from one sensor, from several with delays of their own.
    takes_delays: ClassVar[Literal["none", "one", "several"]] = "none"
    # Whether sensors may send when their outputs leave their predictions.
    takes_on_change: ClassVar[bool] = False

    @classmethod
    def example(cls) -> str:
        """The text of `example.yaml`."""
        return files(cls.__module__).joinpath("example.yaml").read_text(encoding="utf-8")

    @property
    def name(self) -> str:
        """The word behind `family:`."""
        return str(type(self).model_fields["family"].default)

    def mistakes(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        """`problems`, and the schemes of measurement that the family does not take."""
        return [
            *self._problems_of_scheme(plant), *self._problems_of_delay(plant, simulation),
            *self.problems(plant, simulation),
        ]  # fmt: skip

    def _problems_of_scheme(self, plant: Plant) -> Iterator[Problem]:
        law = plant.sampling
        if (law.is_lossy or law.is_random) and not self.takes_losses:
            more = f"or ask for more: sampling: {{min_period: {law.T_min}, max_period: {law.T_max}}}"
            hint = more if law.is_lossy else None
            yield Problem(("measurement", "lost"), "family reachability takes lost samples", self.name, hint=hint)
        if law.has_sensors and not self.takes_sensors:
            what = "family reachability takes sensors with periods or offsets of their own"
            more = "or read all of them at one period: C, sampling: {period: ..}"
            yield Problem(("measurement", "sensors"), what, self.name, hint=f"write family: reachability, {more}")

        if law.is_on_change and not self.takes_on_change:
            what = "family reachability takes sensors that send on change"
            more = "or read the sensors at periods: sensors: {<name>: {.., period: ..}}"
            yield Problem(("measurement", "sensors"), what, self.name, hint=f"write family: reachability, {more}")

    def _problems_of_delay(self, plant: Plant, simulation: SimulationPlan | None) -> Iterator[Problem]:
        if not plant.delays:
            return
        at = next(one.field for one in plant.delays if one.is_late)
        if self.takes_delays == "none":
            hint = "write family: reachability: its estimate is computed again from the stamp on"
            yield Problem(at, "family reachability takes measurements that arrive late", self.name, hint=hint)
        elif self.takes_delays == "one" and len(plant.delays) > 1:
            hint = "write family: reachability, or one delay for all: C, sampling, delay directly under measurement"
            yield Problem(at, "family reachability takes sensors with delays of their own", self.name, hint=hint)
        elif plant.sampling.is_graph:
            what = "late samples go with sensors in step, and with losses of one sensor that has one gain"
            hint = "leave the delay out, or the losses and min_period of sensors"
            yield Problem(at, what, hint=hint)
        for name, signal in ({} if simulation is None else simulation.inputs).items():
            if signal.variables - {"t"}:
                what = "an input that reads the estimate does not go with measurements that arrive late"
                hint = "give it as a function of t: what was applied would have to be computed again with the estimate"
                yield Problem(("simulation", "signals", name), what, hint=hint)

    def problems(self, plant: Plant, simulation: SimulationPlan | None) -> list[Problem]:
        """What `validate` can see without linear algebra: a structure the family does not take, shapes of a
        given gain, options that contradict one another. Fields are paths from the top of the spec."""
        return []

    def only_boxes(self, plant: Plant, why: str) -> list[Problem]:
        """What a family that takes disturbance and noise in boxes says of a white one, and of noise of a covariance.

        why: what the box is needed for.
        """
        found = []
        if plant.intensity is not None:
            what, hint = f"a white disturbance has no bound: {why}", "bound it: {lower: [..], upper: [..]}"
            found.append(Problem(("plant", "disturbance"), what, hint=hint))
        if plant.covariance is not None:
            sizes = [3 * max(0.0, float(plant.covariance[k, k])) ** 0.5 for k in range(plant.p)]
            lower, upper = (", ".join(f"{sign * size:.4g}" for size in sizes) for sign in (-1, 1))
            hint = f"bound it, by three deviations for instance: {{lower: [{lower}], upper: [{upper}]}}"
            what = f"noise of a covariance has no bound: {why}"
            found.append(Problem(("measurement", "noise"), what, hint=hint))
        return found

    def resolved(self, plant: Plant, horizon: float | None) -> Self:
        """The card with what a default leaves to the plant and to the time of its simulation, where there is one."""
        return self

    @property
    def is_given(self) -> bool:
        """Whether the block types what runs, to be analysed only."""
        return getattr(self, "gain", None) is not None

    @abstractmethod
    def given(self) -> Mapping[str, ExactMatrix | None]:
        """The matrices that a design of this card holds, by paper letter: as typed, None where one is to be found."""

    def controlled(self, inputs: tuple[str, ...]) -> frozenset[str]:
        """The inputs that the observer sets itself (by feedback): they need no signal."""
        return frozenset()

    @abstractmethod
    def synthesize(self, plant: Plant, effort: int) -> Design:
        """Find the gain, or take the given one, and a certificate for each period wanted.

        The only verb that may load a solver. Returns outcome `none` with a reason where there is no design;
        never raises for what linear algebra decides.
        """

    @abstractmethod
    def certify(self, plant: Plant, design: Design, effort: int) -> Check:
        """Re-prove the stored certificates from the exact plant and the printed gain, and search
        counterexamples. Holds exactly one required claim, `convergence`. Loads no solver."""

    @abstractmethod
    def observer(self, plant: Plant, design: Design) -> Observer:
        """The observer's equations, with the printed gain."""

    def inclusion(self, plant: Plant, gain: Mapping[str, ExactMatrix]) -> HybridInclusion:
        """The error system under the plant's sampling law. Raises NotImplementedError where the gain is not
        constant."""
        raise NotImplementedError(f"{type(self).__name__} has no constant gain")

    def transients(self, plant: Plant, design: Design) -> Sequence[Transient]:
        """How large the error becomes on the way, from the stored certificates, each proved again."""
        return ()

    def noisy_transients(self, plant: Plant, design: Design) -> Sequence[Transient]:
        """The same under the declared disturbance and noise, from the initial errors that the design was made for."""
        return ()

    def finished(self, plant: Plant, design: Design, effort: int) -> Design:
        """The design that is kept, with what is worth knowing of it beside its verdict. May load a solver."""
        return design

    def bounds_from(self, plant: Plant, design: Design, start: Box, effort: int) -> Sequence[Certificate]:
        """Certificates of how large the error becomes from these initial errors, under what is declared. May load a
        solver."""
        return ()

    def confine(self, plant: Plant, design: Design, start: Box | None) -> Confinement:
        """How this observer's estimate is kept where the slopes hold, from initial errors in `start` (None: any)."""
        from cdobs_cli.bounds.estimate import confine

        return confine(plant, False, self.transients(plant, design), start)

    def observer_as_run(self, plant: Plant, design: Design) -> Observer:
        """The observer that is simulated, exported and proved: with phi continued where the design says so."""
        return self.observer(plant.continued() if design.estimate.continues else plant, design)

    def exhibits(self, plant: Plant, design: Design, check: Check | None, run: Run | None) -> Exhibits:
        """Charts and tables beyond the common ones (states, error, V at samples)."""
        from cdobs_cli.chart import Exhibits

        return Exhibits()
