"""Keys that other tools and papers use, and what this spec has for them: shown with the value that was typed.

A template holds $v, the value as typed; $n, its number without a unit; $r, one over it; $l, its entries without
brackets, $m, these with the other sign; and others of `_PARTS`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from fractions import Fraction
from typing import Any

from cdobs_cli.exact.numbers import decimal_text
from cdobs_cli.exact.parser import read_decimal
from cdobs_cli.exact.units import DIGITS, period_of
from cdobs_cli.fields import as_rows
from cdobs_cli.labels import SECONDS
from cdobs_cli.records import dataclass
from cdobs_cli.spec.reader import LONGEST_FLOW, FieldPath, flow

UNTYPED = ".."
MAX_SHOWN = 8  # entries of a list in what is to be written
_SAMPLING = "write sampling: {period: ..}, {min_period: .., max_period: ..} or {updated: true}"


@dataclass(frozen=True)
class Word:
    """What a foreign key stands for.

    key: of the same block, which is then given; empty where it stands elsewhere. text: the template of what to write.
    """

    key: str
    text: str


@dataclass(frozen=True)
class Typed:
    """A value as typed, the mapping that holds it, and the label of the unit of time."""

    value: Any
    around: Any = None
    time_unit: str = SECONDS

    @property
    def number(self) -> Fraction | None:
        """Of a number, or of one with a unit of time or frequency, which is then a time."""
        return _number(self.value, self.time_unit)


def _words(*groups: tuple[str, str, str]) -> dict[str, Word]:
    """(names, key, template) of each group."""
    return {name: Word(key, text) for names, key, text in groups for name in names.split()}


_RATE = "rate frequency freq fs hz f_s sample_rate sampling_rate sampling_frequency"
_TIME = (
    "ts dt t h t_s step sample_time sampling_time sampling_period sample_period time_step timestep interval "
    "sampling_interval delta tau"
)
_SHORTEST = "min minimum t_min tmin min_interval min_time shortest lower"
_LONGEST = "max maximum t_max tmax max_interval max_time longest upper masp mati"
_LOSSES = (
    "dropout dropouts drops drop loss losses lost packet_loss packet_losses packet_dropout packet_dropouts "
    "max_dropouts max_losses max_dropout consecutive_losses consecutive_dropouts lost_samples lost_packets "
    "missed missing"
)
_CHANCE = "loss_probability loss_rate dropout_probability dropout_rate packet_loss_rate loss_prob"
_LATE = "latency lag delays_s dead_time deadtime transport_delay time_delay network_delay measurement_delay"
_COVARIANCE = "r cov covariance variance var q measurement_covariance noise_covariance r_matrix"
_DEVIATION = "std sigma stddev std_dev sd rms stdev deviation standard_deviation sigma_v"
_BOUND = "bound bounds amplitude abs magnitude max_noise noise_bound vmax limit limits range"
_START = "x0 x_0 init initial initial_condition initial_conditions initial_states"
_GUESS = "xhat0 x_hat0 xhat_0 x_hat_0 initial_guess estimate initial_estimates x0_hat"

_INSIDE_SAMPLING = _words(
    (_RATE, "period", "a rate is 1/period: write {period: $r}"),
    (_TIME, "period", "write {period: $n}"),
    (_SHORTEST, "min_period", "write {min_period: $n, max_period: ..}"),
    (_LONGEST, "max_period", "write {max_period: $n}"),
    ("jitter", "", "write the least and the largest gap: {min_period: $low, max_period: $high}"),
    (_LOSSES, "", "write measurement.lost: $lost, beside sampling"),
    (_CHANCE, "", "write measurement.lost: {probability: $v}, beside sampling"),
    (f"{_LATE} delay delays", "", "write measurement.delay: $n, beside sampling"),
    ("offset phase", "", "offsets are of sensors: sensors: {name: {C: [[..]], period: .., offset: $n}}"),
    ("type kind mode law", "", "write {period: ..}, {min_period: .., max_period: ..} or {updated: true}"),
    ("event event_triggered self_triggered trigger", "", "an observer that chooses its instants: {updated: true}"),
)
_INSIDE_MEASUREMENT = _words(
    (_RATE, "sampling", "a rate is 1/period: write sampling: {period: $r}"),
    (f"{_TIME} period", "sampling", "write sampling: {period: $n}"),
    ("min_period t_min tmin", "sampling", "write sampling: {min_period: $n, max_period: ..}"),
    ("max_period t_max tmax masp mati", "sampling", "write sampling: {max_period: $n}"),
    ("updated", "sampling", "write sampling: {updated: true}"),
    ("sample times instants", "sampling", "write sampling: {period: ..}"),
    ("jitter", "", "write sampling: {min_period: .., max_period: ..}, the least and the largest gap"),
    (_LOSSES, "lost", "write lost: $lost"),
    (_CHANCE, "lost", "write lost: {probability: $v}"),
    (_LATE, "delay", "write delay: $n"),
    ("h output_matrix cd observation", "C", "write C: $rows"),
    ("output outputs y", "C", "write plant.output: $v, beside plant.dynamics; linear outputs are C: [[..]]"),
    ("d feedthrough", "", "write plant.dynamics and plant.output, with the known input in it: it is subtracted"),
    (_COVARIANCE, "noise", "write noise: {covariance: $diagonal}"),
    (_DEVIATION, "noise", "write noise: {std: [$l]}"),
    ("v noise_bound measurement_noise noises", "noise", "write noise: {lower: [..], upper: [..]} or {std: [..]}"),
    ("quantization quantisation quantizer resolution lsb", "noise",
     "write noise: {lower: [..], upper: [..]}, half a step to each side"),
    ("sensor devices", "sensors", "write sensors: {name: {C: [[..]], period: ..}}"),
)  # fmt: skip
_INSIDE_SENSOR = _words(
    (_RATE, "period", "a rate is 1/period: write period: $r"),
    (f"{_TIME}", "period", "write period: $n"),
    ("sampling", "period", "write its period (or min_period and max_period) without sampling"),
    ("phase shift start", "offset", "write offset: $n"),
    (_LOSSES, "lost", "write lost: $lost"),
    (_LATE, "delay", "write delay: $n"),
    ("h output_matrix", "C", "write C: $rows"),
    ("outputs y", "output", "write output: $v"),
    ("jitter", "", "write {min_period: .., max_period: ..}, the least and the largest gap"),
    (_COVARIANCE, "noise", "write noise: {covariance: $diagonal}"),
    (_DEVIATION, "noise", "write noise: {std: [$l]}"),
)
_INSIDE_LOST = _words(
    ("max count number n m consecutive max_consecutive in_a_row samples atmost max_losses dropouts losses", "at_most",
     "write {at_most: $v}"),
    ("p prob rate ratio chance percentage", "probability", "write {probability: $v}"),
)  # fmt: skip
_ENDS = (
    ("min minimum low lo from lb", "lower", "write {lower: [$l], upper: [..]}"),
    ("max maximum high hi to ub", "upper", "write {lower: [..], upper: [$l]}"),
    (_BOUND, "lower", "write {lower: [$m], upper: [$l]}"),
)
_INSIDE_NOISE = _words(
    (_COVARIANCE, "covariance", "write {covariance: $diagonal}"),
    (_DEVIATION, "std", "write {std: [$l]}"),
    *_ENDS,
    ("mean bias", "", "noise has the mean 0: a known offset is taken from the measurement, an unknown one is a state"),
    ("type kind distribution", "", "write {lower: [..], upper: [..]}, {covariance: [[..]]} or {std: [..]}"),
)
_INSIDE_DISTURBANCE = _words(
    (
        f"{_COVARIANCE} psd spectral_density",
        "intensity",
        "of a white one, per unit of time: write {intensity: $diagonal}",
    ),
    (_DEVIATION, "intensity", "of a white one, per unit of time: write {intensity: [[..]]}, the squares"),
    *_ENDS,
)
_INSIDE_PLANT = _words(
    ("process_noise w q disturbances process_covariance noise white_noise", "disturbance", "write disturbance: $white"),
    ("f xdot x_dot ode odes rhs equations model derivatives dxdt vector_field", "dynamics", "write dynamics: $v"),
    ("h y outputs measured measurements", "output", "write output: $v, beside dynamics"),
    ("c", "", "write measurement.C: $rows"),
    ("sampling noise_v", "", "it stands under measurement"),
    ("params param parameter constants consts const", "parameters", "write parameters: {name: number}"),
    ("x state state_names variables vars", "states", "write states: $v"),
    ("u input controls control known_inputs", "inputs", "write inputs: {name: {range: [lo, hi]}}"),
    ("nonlinearity nonlinearities nonlinear psi", "phi", "write phi: $v"),
    ("l slopes slope lipschitz_constants lipschitz_constant gamma jacobian_bounds", "lipschitz",
     "write lipschitz: [[..]], a bound for each slope, or lipschitz: auto"),
    ("region bounds state_bounds constraints box limits", "domain", "write domain: {state: [lo, hi]}"),
    ("units unit", "", "numbers are not converted; labels are states: {theta: rad} and time_unit: s"),
    ("time time_units", "time_unit", "write time_unit: $v"),
    (f"{_START}", "", "write simulation.initial_state: $v"),
    ("d g feedthrough", "", "write dynamics and output, with the input in them"),
)  # fmt: skip
_INSIDE_INPUT = _words((f"min max lower upper low high {_BOUND} interval", "range", "write {range: [lo, hi]}"))
_INSIDE_SIMULATION = _words(
    ("t tf t_f t_end tend t_final tfinal duration stop_time final_time end time tspan length stop", "horizon",
     "write horizon: $n"),
    (_START, "initial_state", "write initial_state: $v"),
    (_GUESS, "initial_estimate", "write initial_estimate: $v"),
    ("dt step max_step time_step timestep solver method tolerance rtol atol", "",
     "leave it out: the steps of the integration follow from its error"),
    ("inputs input u controls signal", "signals", "write signals: {name: expression of t}"),
    ("n_runs trials monte_carlo realisations realizations number_of_runs repetitions", "runs", "write runs: $v"),
    ("noise v", "", "write measurement.noise; it drives the simulation"),
    ("disturbance d w", "", "write plant.disturbance; it drives the simulation"),
    ("random_seed rng", "seed", "write seed: $v"),
)  # fmt: skip
_INSIDE_OBSERVER = _words(
    ("type kind name observer", "family", "write family: $v"),
    ("k", "gain", "write gain: {K: $columns}"),
    ("l", "gain", "write gain: {L: $columns}"),
    ("gains", "gain", "write gain: {K: [[..]]}; of sensors measurement.gains says which there are"),
    ("goal criterion", "objective", "write objective: $v"),
    ("rate min_rate decay_rate", "rate_at_least", "write rate_at_least: $v"),
    (f"{_START} {_GUESS}", "", "write simulation.initial_estimate: $v"),
    ("poles eigenvalues q r", "", "the gain is found from what is to be proved: objective, rate_at_least"),
)
_INSIDE_SPEC = _words(
    ("version", "spec_version", "write spec_version: 1"),
    ("name description", "title", "write title: $v"),
    ("model system", "plant", "write plant: {..}"),
    ("sensors sensor", "measurement", "write measurement: {sensors: ..}"),
    ("sampling", "", "it stands under measurement"),
    ("outputs", "measurement", "write measurement: {C: .., sampling: ..}"),
    ("estimator filter design", "observer", "write observer: {family: ..}"),
    ("sim simulate", "simulation", "write simulation: {..}"),
    ("expected expectations asserts checks tests", "expect", "write expect: [{quantity: .., at_least: ..}]"),
    ("parameters states inputs dynamics", "", "it stands under plant"),
)
_BY_PLACE: Mapping[str, Mapping[str, Word]] = {
    "sampling": _INSIDE_SAMPLING, "measurement": _INSIDE_MEASUREMENT, "sensor": _INSIDE_SENSOR, "lost": _INSIDE_LOST,
    "noise": _INSIDE_NOISE, "disturbance": _INSIDE_DISTURBANCE, "plant": _INSIDE_PLANT,
    "input": _INSIDE_INPUT, "simulation": _INSIDE_SIMULATION, "observer": _INSIDE_OBSERVER, "": _INSIDE_SPEC,
}  # fmt: skip

# Blocks that were typed as a number, a word or a list.
_AS_BLOCK: Mapping[str, tuple[str, str]] = {
    "noise": (
        "noise: {lower: [$m], upper: [$l]}, bounds, or noise: {std: [$l]}, deviations",
        "noise: {covariance: $diagonal}",
    ),
    "disturbance": ("disturbance: {lower: [$m], upper: [$l]}", "disturbance: {intensity: $diagonal}"),
    "lost": ("lost: $lost", "lost: {at_most: 3}"),
    "domain": ("domain: {state: [lo, hi]}", "domain: {state: [lo, hi]}"),
    "inputs": ("inputs: {$named}", "inputs: {name: {range: [lo, hi]}}"),
    "parameters": ("parameters: {name: number}", "parameters: {name: number}"),
    "signals": ("signals: {name: expression of t}", "signals: {name: expression of t}"),
    "sampling": ("sampling: {period: $n}", "sampling: {period: $n}"),
    "initial_box": ("initial_box: {lower: [..], upper: [..]}", "initial_box: {lower: [..], upper: [..]}"),
}


def word_for(at: FieldPath, name: str, typed: Typed, allowed: list[str]) -> tuple[str, str] | None:
    """The key that a foreign one stands for (empty: it stands elsewhere), and what to write; None of other names.

    Args:
        at: the block it was typed in; allowed: the keys that this takes.
    """
    word = _BY_PLACE.get(_place(at), {}).get(re.sub(r"[-\s]+", "_", name.strip()).lower())
    if word is None or (word.key and word.key not in allowed):
        return None
    return word.key, _filled(word.text, typed)


def as_block(at: FieldPath, typed: Typed) -> str | None:
    """What to write for a value that stands in place of a block."""
    value = typed.value
    if at[:2] == ("plant", "inputs") and len(at) == 3 and isinstance(value, list):
        return f"write {at[-1]}: {{range: {_text(value)}}}"
    forms = _AS_BLOCK.get(str(at[-1]) if at else "")
    if forms is None:
        return None
    nested = isinstance(value, list) and any(isinstance(one, list | dict) for one in value)
    if at[-1] == "sampling" and typed.number is None:
        return _SAMPLING
    return f"write {_filled(forms[nested], typed)}"


def _place(at: FieldPath) -> str:
    if at[:2] == ("measurement", "sensors") and len(at) == 3:
        return "sensor"
    if at[:2] == ("plant", "inputs") and len(at) == 3:
        return "input"
    return str(at[-1]) if at else ""


def _filled(text: str, typed: Typed) -> str:
    return re.sub(r"\$[a-z]+", lambda found: _PARTS[found.group()](typed), text)


def _value(typed: Typed) -> str:
    return _text(typed.value)


def _text(value: Any) -> str:
    return UNTYPED if value is None or value == {} else flow(value) or UNTYPED


def _plain(typed: Typed) -> str:
    return _value(typed) if typed.number is None else _decimal(typed.number)


def _inverse(typed: Typed) -> str:
    """One over a rate; `100 Hz` is a period as it stands."""
    number = typed.number
    if not number:
        return UNTYPED
    with_unit = isinstance(typed.value, str) and period_of(typed.value, typed.time_unit) is not None
    return _decimal(number if with_unit else 1 / number)


def _number(value: Any, time_unit: str) -> Fraction | None:
    if isinstance(value, bool) or not isinstance(value, int | str):
        return None
    try:
        return read_decimal(str(value).strip())
    except ZeroDivisionError:
        return None
    except ValueError:
        return period_of(str(value), time_unit)


def _decimal(value: Fraction | None) -> str:
    text = UNTYPED if value is None else decimal_text(value, DIGITS)
    return text if len(text) <= LONGEST_FLOW else UNTYPED


def _entries(typed: Typed, sign: int) -> str:
    listed = typed.value if isinstance(typed.value, list) else [typed.value]
    if not listed or len(listed) > MAX_SHOWN:
        return UNTYPED
    numbers = [_number(one, typed.time_unit) for one in listed]
    return ", ".join(_decimal(None if one is None else sign * one) for one in numbers)


def _losses(typed: Typed) -> str:
    number = typed.number
    if number is None or number < 0:
        return "{at_most: 3} or {probability: 0.1}"
    return f"{{at_most: {number}}}" if number.denominator == 1 and number else f"{{probability: {_decimal(number)}}}"


def _white(typed: Typed) -> str:
    """A white disturbance by its matrix, or the ways there are."""
    value = typed.value
    matrix = next(iter(value.values()), None) if isinstance(value, dict) and len(value) == 1 else value
    if isinstance(matrix, list) and matrix and all(isinstance(row, list) for row in matrix):
        return f"{{intensity: {_text(matrix)}}}, per unit of time, of a white one"
    return "{lower: [..], upper: [..]}, or {intensity: [[..]]} of a white one"


def _matrix(typed: Typed, name: str) -> str:
    """A matrix as typed; numbers in the shape that a matrix of this name has."""
    listed = typed.value if isinstance(typed.value, list) else [typed.value]
    if typed.value is None or any(isinstance(one, list | dict) for one in listed):
        return _value(typed)
    return as_rows(name, listed) or UNTYPED


def _named(typed: Typed) -> str:
    """A list of names as keys."""
    listed = typed.value if isinstance(typed.value, list) else [typed.value]
    return ", ".join(f"{one}: {{}}" for one in listed[:MAX_SHOWN] if isinstance(one, str)) or UNTYPED


def _gap(typed: Typed, sign: int) -> str:
    """The period beside it, less or more so much."""
    around = typed.around if isinstance(typed.around, dict) else {}
    period, change = _number(around.get("period"), typed.time_unit), typed.number
    return UNTYPED if period is None or change is None else _decimal(max(Fraction(0), period + sign * change))


_PARTS: Mapping[str, Callable[[Typed], str]] = {
    "$v": _value, "$n": _plain, "$r": _inverse, "$lost": _losses, "$white": _white, "$named": _named,
    "$l": lambda typed: _entries(typed, 1), "$m": lambda typed: _entries(typed, -1),
    "$rows": lambda typed: _matrix(typed, "C"), "$columns": lambda typed: _matrix(typed, "K"),
    "$diagonal": lambda typed: _matrix(typed, "covariance"),
    "$low": lambda typed: _gap(typed, -1), "$high": lambda typed: _gap(typed, 1),
}  # fmt: skip
