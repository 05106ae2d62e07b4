"""The methods by the names that their certificates have: where each one stands. One is loaded when a certificate of it
is read, or a search asks for it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from importlib import import_module
from typing import TYPE_CHECKING, TypeAlias

from cdobs_cli.design import COUNTEREXAMPLE
from cdobs_cli.records import dataclass

if TYPE_CHECKING:
    from cdobs_cli.certify.methods.base import Method


@dataclass(frozen=True)
class Named:
    """A method that need not be loaded: its name, its module and, in it, its class."""

    name: str
    module: str
    kind: str

    def loaded(self) -> type[Method]:
        method: type[Method] = getattr(import_module(self.module), self.kind)
        return method


Known: TypeAlias = "type[Method] | Named"


def loaded(methods: Iterable[Known]) -> Iterator[type[Method]]:
    """Each of them, loaded when its turn comes."""
    return (method.loaded() if isinstance(method, Named) else method for method in methods)


def _at(module: str, kind: str, name: str) -> Named:
    return Named(name, f"{__package__}.{module}", kind)


EVERY_PERIOD = _at("dead_beat", "EveryPeriod", "every_period")
# Those that need no structure, the quickest first.
GENERAL: tuple[Named, ...] = (
    _at("dead_beat", "DeadBeat", "dead_beat"),
    _at("spectral", "SpectralRadius", "spectral_radius"),
    _at("common_quadratic", "CommonQuadratic", "common_quadratic"),
    _at("polygon", "Polygon", "polygon"),
    _at("clock.certificate", "Clock", "clock"),
    _at("clock.graph", "ClockGraph", "clock_graph"),
)
OPEN_LOOP = _at("open_loop", "OpenLoop", "open_loop")
UNCORRECTED = _at("open_loop", "Uncorrected", "uncorrected")
PLANAR = _at("planar.extremals", "Planar", "planar")
CELLS_OF_GAINS = _at("planar.every_gain", "CellsOfGains", "cells_of_gains")
ON_CHANGE = _at("on_change.certificate", "OnChange", "on_change")
WIRTINGER = _at("wirtinger.certificate", "Wirtinger", "wirtinger")
NO_GAIN = _at("any_gain", "NoGain", "any_gain")
# Of the size of the error. By the question: of each bound one is kept, the least.
ACCURACY: tuple[Named, ...] = (
    _at("peak.certificate", "Peak", "peak"),
    _at("peak.from_zero", "PeakFromZero", "peak_from_zero"),
    _at("mean_square.average", "Average", "mean_square"),
    _at("mean_square.every_time", "EveryTime", "mean_square_at_every_time"),
    _at("mean_square.from_zero", "MeanSquareFromZero", "mean_square_from_zero"),
    _at("response", "PeakResponse", "peak_response"),
    _at("response", "MeanSquareResponse", "mean_square_response"),
    _at("clock.graph_size", "GraphPeak", "graph_peak"),
    _at("clock.graph_size", "GraphMeanSquare", "graph_mean_square"),
    _at("on_change.certificate", "OnChangePeak", "on_change_peak"),
)
# What the designs of every family may hold beside the methods of its own.
COMMON: tuple[Named, ...] = (
    *ACCURACY,
    _at("counterexample", "Counterexample", COUNTEREXAMPLE),
    _at("counterexample", "Attained", "attained"),
)
