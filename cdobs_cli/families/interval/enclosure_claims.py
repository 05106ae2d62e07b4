"""Claims that the bounds enclose the state and stay bounded: by the orthant, a cone inside it, or refuted by a run."""

from __future__ import annotations

from cdobs_cli.certificate import Bound, Status, Witness
from cdobs_cli.certify import search
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import Exact, lower_text, upper_text
from cdobs_cli.families.interval.analysis import Analysis
from cdobs_cli.families.interval.cone import Cone
from cdobs_cli.families.interval.crossing_search import crossing_from_box, crossing_from_signals, find_crossing
from cdobs_cli.families.interval.hurwitz import Hurwitz, refute_hurwitz, refute_width
from cdobs_cli.families.interval.method import SOURCE

_ORTHANT = "exact condition E(s) >= 0"
_SOURCE = f"{SOURCE}, (11), (12)"
_STEPS = tuple(2e-7 * 4**k for k in range(14))  # relative steps above what is proved of the scan for a first crossing
_FAR = 0.01  # from where on disturbance and noise alone are tried too
_WIDTH = 1e-7


def positivity(a: Analysis) -> Status:
    """Whether x stays between its bounds from every box of x(0) under the law; with the hull predictor the bounds
    meant are those without it, which are not run: then there is no run to look for that loses the state."""
    limit, T = a.system.limit, a.law.T_max
    text = f"{_whose(a)}x stays between its bounds from every box of x(0) for every {a.law.symbols}"
    proved = "inf" if limit.proved is None else lower_text(fraction_ball(limit.proved))
    refuted = None if limit.refuted is None else upper_text(fraction_ball(limit.refuted))
    a.bounds["positivity_period_max.orthant"] = Bound(proved, refuted, method=_ORTHANT, about="every box of z(0)")
    _enclosure_bracket(a)
    if a.ordered:
        margin = "inf" if limit.proved is None else lower_text(fraction_ball(limit.proved) - a.T)
        text += f": E(s) >= 0 for 0 <= s <= {T}, so that z = S x does from every box of z(0)"
        method = "bisection in s, ball arithmetic"
        return a.say("positivity", "certificate", "proved", text, _SOURCE, margin=margin, method=method)
    if a.cone is not None:
        text += f": the errors it starts stay in the cone {cone_text(a.cone)}, which E(s) maps into itself"
        return a.say("positivity", "certificate", "proved", text, _SOURCE, method=Cone.how)
    witness = None if a.is_hull else find_crossing(a.system, a.law)
    if witness is not None:
        method = "a box of x(0) and a word of periods, ball arithmetic"
        why = crossing_text(witness)
        return a.say("positivity", "certificate", "refuted", text, _SOURCE, method=method, witness=witness, reason=why)
    if limit.fails_before(a.T) and limit.column is not None:
        entry = limit.column % a.plant.n + 1
        when = f"is negative a time {refuted} after a sample"
        text += f"; from a box of z(0) they need not: entry ({entry}, {entry}) of E {when}"
    return a.say("positivity", "certificate", "undecided", text, _SOURCE)


def _whose(a: Analysis) -> str:
    return "without the hull predictor " if a.is_hull else ""


def cone_text(cone: Cone) -> str:
    """The rows of H as inequalities: 0 <= e1 <= 2.5 e2, ..; errors of z_lower first, then of z_upper."""
    inequalities = ["e >= 0"]
    for row in cone.H.rows:
        below = " + ".join(_term(-value, j, up=True) for j, value in enumerate(row) if value.sign() == -1)
        above = " + ".join(_term(value, j, up=False) for j, value in enumerate(row) if value.sign() == 1)
        inequalities.append(f"{below} <= {above or '0'}")
    return ", ".join(inequalities)


def _term(value: Exact, j: int, *, up: bool) -> str:
    """A coefficient in short decimals, on the side that makes the printed cone no larger, and its entry of e."""
    text = (upper_text if up else lower_text)(value.ball(), 6)
    return f"e{j + 1}" if text == "1" else f"{text} e{j + 1}"


def crossing_text(witness: Witness) -> str:
    """What a witness shows, in a clause."""
    data = witness.data
    lower, upper, state = (", ".join(data[name]) for name in ("lower", "upper", "state"))
    word = f" and T_k = {', '.join(witness.times)}" if witness.times else ""
    box = f"from the box [{lower}] to [{upper}] around x(0) = ({state})"
    return f"{box}{word} the {data['bound']} crosses the state a time {data['after']} after the last sample"


def _enclosure_bracket(a: Analysis) -> None:
    """`positivity_period_max`: the largest period shown, by orthant or cone, and the smallest with a crossing."""
    limit = a.system.limit
    if limit.proved is None:
        a.bounds["positivity_period_max"] = Bound("inf", None, method=_ORTHANT, about="every box of x(0)")
        return
    proved, method = fraction_ball(limit.proved), _ORTHANT
    for T in a.enclosed_by_cones():
        if T.ball() > proved:
            proved, method = T.ball(), "a cone of errors"
    crossing = None if a.is_hull else first_crossing(a, float(proved.upper()))
    a.bounds["positivity_period_max"] = Bound(
        lower_text(proved), None if crossing is None else str(crossing), method=method, about="every box of x(0)"
    )


def first_crossing(a: Analysis, proved: float) -> Exact | None:
    """The smallest period found above `proved` with a crossing: a scan in growing steps, then bisection."""
    start = proved if proved > 0 else float(a.law.T_max) / 1000
    low = start
    for step in _STEPS:
        high = start * (1 + step)

        def crossing(T: Exact, far: bool = step >= _FAR) -> Witness | None:
            law = a.law.with_period(T)
            return crossing_from_box(a.system, law) or (crossing_from_signals(a.system, law) if far else None)

        met = search.smallest(crossing, low, high / low, _WIDTH, span=high / low)
        if met is not None:
            return met[0]
        low = high
    return None


def boundedness(a: Analysis) -> Status:
    """Whether the width of the bounds stays bounded under the law.

    While E(s) >= 0, exactly if Mtot is Hurwitz, for every sampling; beyond, if the errors in the cone shrink from
    sample to sample, or the sampled map of the width contracts.
    """
    if a.ordered:
        return _boundedness_in_order(a)
    text = f"{_whose(a)}the width of the bounds stays bounded for every {a.law.symbols}, and settles"
    if a.cone is not None and a.shrinks:
        method = "the errors in the cone shrink from sample to sample"
        return a.say("boundedness", "certificate", "proved", text, method=method)
    if a.contracts and (a.cone is not None or not a.system.cut):
        method = "|E_w(s)| w* <= (1 - rate s) w*, ball arithmetic in s"
        return a.say("boundedness", "certificate", "proved", text, method=method)
    witness = None if a.system.cut else refute_width(a.system, a.law)
    if witness is not None:
        reason = f"with T_k = {witness.times[0]} throughout it grows by {witness.multiplier} a sample"
        method = "multiplier of the width"
        return a.say("boundedness", "certificate", "refuted", text, method=method, witness=witness, reason=reason)
    return a.say("boundedness", "certificate", "undecided", text)


def _boundedness_in_order(a: Analysis) -> Status:
    text = "Mtot is Hurwitz: while the bounds hold, their width stays bounded for every sampling, and settles"
    if a.hurwitz_rate is not None:
        margin = lower_text(a.hurwitz_rate)
        return a.say("boundedness", "certificate", "proved", text, margin=margin, method=Hurwitz.how)
    witness, method = refute_hurwitz(a.system.Mtot), "w >= 0 with Mtot w >= rate w"
    if witness is None:
        return a.say("boundedness", "certificate", "undecided", text, method=method)
    reason = f"widths of z along ({', '.join(witness.data['width'])}) grow at rate {witness.data['rate']}"
    return a.say("boundedness", "certificate", "refuted", text, method=method, witness=witness, reason=reason)
