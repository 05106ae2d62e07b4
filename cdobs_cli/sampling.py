"""The sampling law: when measurements come, which laws it holds, and how it is put in words."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal

from cdobs_cli import sensors as schedule
from cdobs_cli import thresholds as sent
from cdobs_cli.exact.numbers import EXACT_ZERO, Exact, ExactMatrix
from cdobs_cli.records import dataclass
from cdobs_cli.sensors import GAINS, MAX_LOST, Gains, Phase, Reading, Sensor
from cdobs_cli.thresholds import Threshold

if TYPE_CHECKING:
    from cdobs_cli.graph import Graph

SamplingKind = Literal["periodic", "aperiodic", "lossy", "random", "multirate", "graph", "updated", "on_change"]


@dataclass(frozen=True)
class SamplingLaw:
    """When measurements come: t_(k+1) - t_k in [T_min, T_max] (time units of the plant).

    periodic: T_min = T_max; aperiodic: 0 <= T_min < T_max; lossy: samples every T_min of which at most `lost` in a row
    are lost, so t_(k+1) - t_k is one of T_min, 2 T_min, .., T_max = (lost + 1) T_min; random: samples every T_min,
    which is T_max too, each lost with this probability, independently: then there is no longest time between two;
    multirate: some outputs at each sample, by `sensors` with periods in proportion to the shortest one, `base`; T_min
    and T_max are the shortest and longest time between two samples of any of them, `gains` says for which samples the
    observer has gains of their own; graph: the same of sensors whose samples may be lost, that keep no step, or that
    are in step after very long only: what is read when is told by the timed graph; updated: the observer chooses, both
    are 0; on_change: an output is sent when it is as far from its prediction as its `thresholds` say, compared all the
    time (both are 0) or every T_min = T_max.
    """

    kind: SamplingKind
    T_min: Exact = EXACT_ZERO
    T_max: Exact = EXACT_ZERO
    lost: int = 0
    probability: Exact = EXACT_ZERO
    sensors: tuple[Sensor, ...] = ()
    gains: Gains = "by_phase"
    base: Exact = EXACT_ZERO
    thresholds: tuple[Threshold, ...] = ()

    @staticmethod
    def on_change(thresholds: Sequence[Threshold], check_every: Exact | None = None) -> SamplingLaw:
        """Outputs that are sent beyond their thresholds; compared all the time where no time between is given."""
        h = EXACT_ZERO if check_every is None else check_every
        return SamplingLaw("on_change", h, h, thresholds=tuple(thresholds))

    @staticmethod
    def multirate(base: Exact, sensors: Sequence[Sensor], gains: Gains = "by_phase") -> SamplingLaw:
        """Sensors whose shortest period is `base`; where all are read at every sample, a constant period.

        Raises: ValueError for a graph that is too large."""
        if any(one.lost or one.is_free for one in sensors) or not schedule.is_bounded(sensors):
            from cdobs_cli.graph import graph

            timed = graph(sensors)
            if timed is None:
                raise ValueError("sensors of which too much is possible")
            T_min, T_max = _times(base, timed.shortest), _times(base, timed.longest)
            return SamplingLaw("graph", T_min, T_max, sensors=tuple(sensors), gains=gains, base=base)
        gaps = [phase.gap for phase in schedule.phases(sensors)]
        if len(gaps) == 1:
            return SamplingLaw.periodic(base)
        T_min, T_max = (_times(base, gap) for gap in (min(gaps), max(gaps)))
        return SamplingLaw("multirate", T_min, T_max, sensors=tuple(sensors), gains=gains, base=base)

    @staticmethod
    def randomly(period: Exact, probability: Exact) -> SamplingLaw:
        """Every period, each sample lost with the probability, in [0, 1)."""
        if probability.sign() == 0:
            return SamplingLaw.periodic(period)
        return SamplingLaw("random", period, period, probability=probability)

    @staticmethod
    def periodic(period: Exact, lost: int = 0) -> SamplingLaw:
        """Every period; lost: so many in a row at most."""
        if not lost:
            return SamplingLaw("periodic", period, period)
        return SamplingLaw("lossy", period, period * Exact(lost + 1), lost)

    @property
    def period(self) -> Exact:
        """What `with_period` replaces: the period, lost samples or not, the largest of an interval, or the shortest of
        all sensors'."""
        if self.has_sensors:
            return self.base
        return self.T_min if self.is_lossy else self.T_max

    def with_period(self, T: Exact) -> SamplingLaw:
        """The law with its period (or its largest period) replaced; a smaller T_max takes T_min along, the shortest
        period of sensors the others, and their offsets, in proportion."""
        if self.is_on_change:
            return self
        if self.has_sensors:
            return SamplingLaw.multirate(T, self.sensors, self.gains)
        if self.is_random:
            return SamplingLaw.randomly(T, self.probability)
        if self.kind in ("periodic", "lossy"):
            return SamplingLaw.periodic(T, self.lost)
        T_min = self.T_min if float(self.T_min) <= float(T) else T
        return SamplingLaw(self.kind, T_min, T)

    @property
    def is_periodic(self) -> bool:
        """Whether all periods are one number."""
        return not self._is_of_its_own and self.T_min == self.T_max

    @property
    def _is_of_its_own(self) -> bool:
        """Whether an interval of certain periods does not say it all."""
        return self.is_updated or self.is_random or self.has_sensors or self.is_on_change

    @property
    def is_lossy(self) -> bool:
        """Whether samples of a constant period may be lost."""
        return self.kind == "lossy"

    @property
    def is_random(self) -> bool:
        """Whether samples of a constant period are lost by chance."""
        return self.kind == "random"

    @property
    def is_multirate(self) -> bool:
        """Whether sensors have periods or offsets of their own, and what is read when repeats."""
        return self.kind == "multirate"

    @property
    def is_graph(self) -> bool:
        """Whether what is read when is one of several possibilities, told by the timed graph."""
        return self.kind == "graph"

    @property
    def has_sensors(self) -> bool:
        """Whether samples differ in what is read, or in the gain that they are used with."""
        return self.is_multirate or self.is_graph

    @cached_property
    def graph(self) -> Graph:
        """Of sensors. Raises: ValueError of any other law."""
        from cdobs_cli.graph import graph

        timed = graph(self.sensors) if self.has_sensors else None
        if timed is None:
            raise ValueError("no timed graph")
        return timed

    @property
    def readings(self) -> tuple[Reading, ...]:
        """What samples read that have gains of their own under `by_phase`; empty where all are alike."""
        return self.phases or (self.graph.readings if self.is_graph else ())

    @property
    def is_on_change(self) -> bool:
        """Whether sensors send when their outputs leave their predictions."""
        return self.kind == "on_change"

    @property
    def is_checked(self) -> bool:
        """Whether sensors that send on change compare at multiples of a time."""
        return self.is_on_change and self.T_max.sign() == 1

    @cached_property
    def phases(self) -> tuple[Phase, ...]:
        """The samples of one hyperperiod of a multirate law; empty of any other."""
        return schedule.phases(self.sensors) if self.is_multirate else ()

    @property
    def gaps(self) -> tuple[Exact, ...]:
        """The time from each sample of a hyperperiod to the next."""
        return tuple(_times(self.base, phase.gap) for phase in self.phases)

    @property
    def hyperperiod(self) -> Exact:
        """After which time the sensors of a multirate law are read as before."""
        return _times(self.base, schedule.hyperperiod(self.sensors))

    def time(self, share: Fraction) -> Exact:
        """So much of the shortest period of a multirate law."""
        return _times(self.base, share)

    def gain_columns(self, outputs: int) -> int:
        """How many columns an observer's gains have together: one for each output that is read, sample by sample."""
        return sum(len(one.outputs) for one in self.readings) if self.has_sensors else outputs

    def unread(self, outputs: int) -> list[list[int]]:
        """The outputs that each reading leaves out; empty of a law without sensors."""
        return [[k for k in range(outputs) if k not in one.outputs] for one in self.readings]

    def split(self, gain: ExactMatrix, outputs: int) -> list[ExactMatrix]:
        """The gain of each reading, shape (n, outputs) and 0 for outputs that are not read then, of the gains of all of
        them side by side (`gain_columns`).

        Raises: ValueError for another number of columns or outputs."""
        if gain.shape[1] != self.gain_columns(outputs) or sum(len(one.outputs) for one in self.sensors) != outputs:
            raise ValueError("a gain has a column for each output that a sample reads")
        first, split = 0, []
        for one in self.readings:
            place = {output: first + k for k, output in enumerate(one.outputs)}
            columns = [place.get(output) for output in range(outputs)]
            split.append(ExactMatrix([[EXACT_ZERO if k is None else row[k] for k in columns] for row in gain.rows]))
            first += len(place)
        return split

    @property
    def multiples(self) -> tuple[Exact, ...]:
        """All that t_(k+1) - t_k may be, where these are finitely many: the period, of a lossy law its multiples."""
        if self.is_lossy:
            return tuple(self.T_min * Exact(k) for k in range(1, self.lost + 2))
        return (self.T_max,) if self.is_periodic else ()

    @property
    def is_updated(self) -> bool:
        """Whether the observer chooses its instants."""
        return self.kind == "updated"

    @property
    def from_zero(self) -> bool:
        """Whether periods may be as short as one likes."""
        return self.kind == "aperiodic" and self.T_min.sign() == 0

    @property
    def is_bounded(self) -> bool:
        """Whether the periods are known to lie in an interval [T_min, T_max] with T_max > 0."""
        return not self._is_of_its_own and self.T_max.sign() == 1 and self.T_min.sign() in (0, 1)

    def contains(self, other: SamplingLaw) -> bool:
        """Whether every sequence of periods of the other law is certainly one of this law."""
        if self == other:
            return True
        if any(law.is_random or law.has_sensors or law.is_on_change for law in (self, other)):
            return False
        if self.is_lossy:
            return bool(other.multiples) and all(map(self.allows, other.multiples))
        return self.T_min.is_at_most(other.T_min) and other.T_max.is_at_most(self.T_max)

    def allows(self, gap: Exact) -> bool:
        """Whether t_(k+1) - t_k may certainly be so much for ever; of samples lost by chance or sent on change nothing
        is certain, and sensors of different periods are not all read at each."""
        if self.is_random or self.has_sensors or self.is_on_change:
            return False
        if self.is_lossy:
            return any(gap == one or (gap - one).sign() == 0 for one in self.multiples)
        return self.T_min.is_at_most(gap) and gap.is_at_most(self.T_max)

    def repeats(self, gaps: Sequence[Exact], readings: Sequence[int | None]) -> bool:
        """Whether a run of sensors may certainly take steps so long for ever, with these readings at their ends (None:
        nothing arrives), one after the other and again from the first."""
        if not self.is_graph:
            return False
        known = [share for gap in gaps if (share := share_of(gap, self.base)) is not None]
        return len(known) == len(gaps) and self.graph.repeats(known, readings, self.sensors)

    @property
    def symbols(self) -> str:
        """`T_k = 0.6`, `T_k in [0, 5]`, `T_k in {0.6, .., 1.8}`, `|y - C x_hat| < 0.05 between messages`."""
        if self.is_on_change:
            return f"|y - C x_hat| < {', '.join(str(one.delta) for one in self.thresholds)} between messages"
        if self.is_multirate:
            return f"T_k in {{{', '.join(map(str, self.gaps))}}}"
        if self.is_graph:
            return f"T_k in [{self.T_min}, {self.T_max}]"
        if self.is_lossy:
            return f"T_k in {{{self.T_min}, .., {self.T_max}}}"
        if self.is_random:
            return f"T_k in {{{self.T_min}, 2 * {self.T_min}, ..}}"
        return f"T_k = {self.T_max}" if self.is_periodic else f"T_k in [{self.T_min}, {self.T_max}]"

    @property
    def words(self) -> str:
        """Behind "sampling": `every 0.6`, `at periods in [0, 5]`, `every 0.6, at most 2 in a row lost`, `x every 0.1,
        theta every 0.4 from 0.2 on`, `on change, radar beyond 0.05, compared every 0.01`."""
        if self.is_on_change:
            return f"on change, {self._thresholds_text}" + (f", compared every {self.T_max}" if self.is_checked else "")
        if self.has_sensors:
            return self._sensors_text(lambda share: str(_times(self.base, share)))
        if self.is_random:
            return f"every {self.T_min}, each sample lost with probability {self.probability}"
        if self.is_lossy:
            return f"every {self.T_min}, at most {self.lost} in a row lost"
        return f"every {self.T_max}" if self.is_periodic else f"at periods in [{self.T_min}, {self.T_max}]"

    @property
    def open_end(self) -> str:
        """The law without its period: `constant periods`, `periods from 0.1`, `x every T, theta every 4 T`."""
        if self.is_on_change:
            return self.words
        if self.has_sensors:
            told = self._sensors_text(lambda share: "T" if share == 1 else f"{share} T")
            return f"T the shortest period of the sensors, the others in proportion: {told}"
        if self.is_random:
            return f"constant periods, each sample lost with probability {self.probability}"
        if self.is_lossy:
            return f"constant periods, at most {self.lost} samples in a row lost"
        return "constant periods" if self.is_periodic else f"periods from {self.T_min}"

    def text(self, unit: str) -> str:
        """For people, in a unit of time: `every 0.6 s`, `at intervals anywhere in [0, 5] s`."""
        if self.is_updated:
            return "at instants that the observer chooses"
        if self.is_on_change:
            when = f", compared every {self.T_max} {unit}" if self.is_checked else ""
            return f"when an output is as far from its prediction as its threshold: {self._thresholds_text}{when}"
        if self.has_sensors:
            return self._sensors_text(lambda share: f"{_times(self.base, share)} {unit}")
        if self.is_random:
            return f"every {self.T_min} {unit}, each lost with probability {self.probability}, independently"
        if self.is_lossy:
            return f"every {self.T_min} {unit}, of which at most {self.lost} in a row are lost"
        return (
            f"every {self.T_max} {unit}"
            if self.is_periodic
            else f"at intervals anywhere in [{self.T_min}, {self.T_max}] {unit}"
        )

    @property
    def _thresholds_text(self) -> str:
        return ", ".join(f"{one.name} beyond {one.delta}" for one in self.thresholds)

    def _sensors_text(self, time: Callable[[Fraction], str]) -> str:
        """`x every 0.1, theta every 0.4 from 0.2 on, at most 2 in a row lost`, `z 0.1 to 0.3 apart`, a time by its
        share of the shortest period."""
        return ", ".join(_sensor_text(one, time) for one in self.sensors)

    def document(self) -> dict[str, Any]:
        """As in a spec: {period}, {min_period, max_period} or {updated}; {period, lost} where samples may be lost;
        of sensors the shortest period, and theirs as multiples of it, or their thresholds."""
        if self.is_on_change:
            checks = {"check_every": str(self.T_max)} if self.is_checked else {}
            return {"on_change": sent.document(self.thresholds)} | checks
        if self.has_sensors:
            return {"period": str(self.base), "sensors": schedule.document(self.sensors), "gains": self.gains}
        if self.is_random:
            return {"period": str(self.T_min), "probability": str(self.probability)}
        if self.is_lossy:
            return {"period": str(self.T_min), "lost": self.lost}
        if self.kind == "periodic":
            return {"period": str(self.T_max)}
        if self.kind == "aperiodic":
            return {"min_period": str(self.T_min), "max_period": str(self.T_max)}
        return {"updated": True}

    @staticmethod
    def from_document(document: dict[str, Any]) -> SamplingLaw:
        """Raises: TypeError, ValueError on anything `document` did not write."""
        match document:
            case {"updated": True, **rest} if not rest:
                return SamplingLaw("updated")
            case {"on_change": entries, **rest} if not rest:
                return SamplingLaw.on_change(sent.from_document(entries))
            case {"on_change": entries, "check_every": str(period), **rest} if not rest:
                law = SamplingLaw.on_change(sent.from_document(entries), Exact(period))
            case {"period": str(period), **rest} if not rest:
                law = SamplingLaw.periodic(Exact(period))
            case {"period": str(period), "lost": lost, **rest} if not rest and _is_number_of_losses(lost):
                law = SamplingLaw.periodic(Exact(period), lost)
            case {"period": str(period), "probability": str(probability), **rest} if not rest:
                law = SamplingLaw.randomly(Exact(period), Exact(probability))
                if law.probability.sign() != 1 or (law.probability - Exact(1)).sign() != -1:
                    raise ValueError("not a sampling law")
            case {"period": str(period), "sensors": sensors, "gains": gains, **rest} if not rest and gains in GAINS:
                law = SamplingLaw.multirate(Exact(period), schedule.from_document(sensors), gains)
                if not law.has_sensors:
                    raise ValueError("not a sampling law")
            case {"min_period": str(shortest), "max_period": str(longest), **rest} if not rest:
                law = SamplingLaw("aperiodic", Exact(shortest), Exact(longest))
            case _:
                raise ValueError("not a sampling law")
        if law.T_max.sign() != 1 or law.T_min.sign() == -1 or (law.T_max - law.T_min).sign() == -1:
            raise ValueError("periods that no sampling law has")
        return law


def _sensor_text(one: Sensor, time: Callable[[Fraction], str]) -> str:
    if one.step is None:
        return f"{one.name} {time(one.least or one.every)} to {time(one.every)} apart"
    since = f" from {time(one.offset)} on" if one.offset else ""
    losses = f", at most {one.lost} in a row lost" if one.lost else ""
    return f"{one.name} every {time(one.step)}{since}{losses}"


def _times(T: Exact, share: Fraction) -> Exact:
    """T share, cancelled where T is an expression."""
    if T.rational is not None or share == 1:
        return T * Exact(share)
    from cdobs_cli.exact.rational import simplify

    return Exact(simplify((T * Exact(share)).expression))


def share_of(time: Exact, base: Exact) -> Fraction | None:
    """time / base where that is rational, as an identity."""
    if time.rational is not None and base.rational is not None:
        return time.rational / base.rational
    from cdobs_cli.exact.rational import simplify

    return Exact(simplify(time.expression / base.expression)).rational


def _is_number_of_losses(value: Any) -> bool:
    return type(value) is int and 0 < value <= MAX_LOST
