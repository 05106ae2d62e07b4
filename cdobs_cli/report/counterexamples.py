"""Counterexamples in words: which slopes, when, what grows, and whom it concerns."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction

from cdobs_cli.certificate import Witness
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.plant import Plant, Quantity
from cdobs_cli.report.numbers import end_text, float_or_none, number_text
from cdobs_cli.sampling import SamplingLaw

_TOLD = 4  # arcs, or periods, that a sentence tells one by one
# What the words say already.
SAID = ("arcs", "readings", "outputs", "direction", "states")


def in_words(witness: Witness, plant: Plant, law: SamplingLaw, unit: str) -> str:
    """A few sentences."""
    if witness.kind == "vector" and not _direction(witness, plant):
        return "These numbers defeat the claim."
    told = (_what_happens(witness, plant, law, unit), _growth(witness), _whom(witness))
    return " ".join(sentence for sentence in told if sentence)


def quantity_names(witness: Witness, plant: Plant) -> tuple[str, ...]:
    """Of each value of an arc the slope that it is, by the names of the states."""
    return tuple(_name(plant.slopes.quantities, entry, plant.states) for entry in witness.entries)


def _name(quantities: Sequence[Quantity], entry: tuple[int, int], states: tuple[str, ...]) -> str:
    known = next((rho for rho in quantities if rho.entry == entry), None)
    i, j = entry
    if known is not None:
        return known.text(states)
    return f"d phi_{states[i]} / d {states[j]}" if max(entry) < len(states) else f"slope {i + 1}.{j + 1}"


def _what_happens(witness: Witness, plant: Plant, law: SamplingLaw, unit: str) -> str:
    if witness.kind == "noise":
        return "Slopes, disturbance and noise, repeated again and again, make the error as large as is said."
    if witness.kind == "box":
        return "A box of x(0) and a word of sampling periods defeat the claim: the state leaves its bounds."
    if witness.kind == "point":
        return "At one point of the domain the claim does not hold."
    if witness.kind == "vector":
        return _direction(witness, plant)
    slopes = _slopes(witness, plant, unit)
    return f"Samples come {_word(witness, law, unit)}{slopes and f', while {slopes}'}, again and again."


def _direction(witness: Witness, plant: Plant) -> str:
    """Of an error that no measurement shows."""
    entries = witness.data.get("direction")
    if not isinstance(entries, list) or len(entries) > plant.n:
        return ""
    parts = [
        f"{number_text(float(Fraction(text)), 4)} {name}"
        for text, name in zip(entries, plant.states, strict=False)
        if Fraction(text)
    ]
    direction = " + ".join(parts).replace("+ -", "- ")
    values = witness.values[0] if witness.values else ()
    fixed = ", ".join(
        f"{name} = {_short(value)}" for name, value in zip(quantity_names(witness, plant), values, strict=False)
    )
    return f"An error along {direction} is never seen by a measurement{fixed and f', with {fixed}'}."


def _word(witness: Witness, law: SamplingLaw, unit: str) -> str:
    """When samples come: `every 1.5 s`, `after 0.1 s (a), 0.2 s (nothing arrives)`."""
    times = list(map(_number, witness.times))
    counts = witness.data.get("arcs") or [len(times)]
    starts = [sum(counts[:k]) for k in range(len(counts))]
    periods = [sum(times[start : start + count]) for start, count in zip(starts, counts, strict=True)]
    readings = witness.data.get("readings") or [None] * len(periods)
    names = [one.name for one in law.readings]
    if len(set(map(_rounded, periods))) == 1 and not witness.data.get("readings"):
        return f"every {_rounded(periods[0])} {unit}"
    listed = []
    for period, reading in zip(periods, readings, strict=False):
        read = f" ({names[reading]})" if isinstance(reading, int) and reading < len(names) else ""
        silent = " (nothing arrives)" if witness.data.get("readings") and reading is None else ""
        listed.append(f"{_rounded(period)} {unit}{read}{silent}")
    more = f", and so on ({len(listed)} in all)" if len(listed) > 2 * _TOLD else ""
    return f"after {', '.join(listed[: 2 * _TOLD])}{more}"


def _slopes(witness: Witness, plant: Plant, unit: str) -> str:
    """`d phi_omega / d theta is -1`, `.. is 1 for 0.3 s, -1 for 0.7 s`."""
    named, told = quantity_names(witness, plant), []
    for k, name in enumerate(named):
        parts: list[tuple[str, float]] = []
        for time, row in zip(witness.times, witness.values, strict=False):
            if k >= len(row):
                return ""
            value = _short(row[k])
            if parts and parts[-1][0] == value:
                parts[-1] = value, parts[-1][1] + _number(time)
            else:
                parts.append((value, _number(time)))
        if len(parts) == 1:
            told.append(f"{name} is {parts[0][0]}")
        else:
            listed = ", ".join(f"{value} for {_rounded(time)} {unit}" for value, time in parts[:_TOLD])
            told.append(f"{name} is {listed}{', and so on' if len(parts) > _TOLD else ''}")
    return "; ".join((*told[:_TOLD], *(["and so on"] if len(told) > _TOLD else []), *_outputs(witness)))


def _outputs(witness: Witness) -> Iterator[str]:
    """The slopes of outputs, sample by sample."""
    for column in witness.data.get("outputs", ()):
        values = list(map(_short, column["values"]))
        k = int(column["entry"][0]) + 1
        said = values[0] if len(set(values)) == 1 else f"{', '.join(values[:_TOLD])} at the samples in turn"
        yield f"the slope of y{k} is {said}"


def _growth(witness: Witness) -> str:
    size = float_or_none(witness.multiplier)
    if size is None or witness.kind in ("noise", "point"):
        return ""
    text = end_text(witness.multiplier, 4 if size > 1.01 else 7, up=False)
    if size > 1:
        how = "from sample to sample" if len(witness.data.get("arcs", ())) <= 1 else "each time"
        return f"Some error is then at least {text} times as large {how}."
    return "Some error then never decays."


def _whom(witness: Witness) -> str:
    if witness.about == "class" and witness.kind == "noise":
        return "Some plant with these slopes does so; the typed one may stay below."
    if witness.about == "class":
        return "Some plant with these slopes does so; the typed one may still converge."
    return "The plant as typed does so."


def _number(text: str) -> float:
    return float(Exact(text))


def _rounded(value: float) -> str:
    return number_text(value, 6)


def _short(text: str) -> str:
    return text if len(text) <= 8 else number_text(float(Exact(text)), 5)
