"""What is proved of a design with a carried certificate: the premises on c, the floor of Pi, and what follows."""

from __future__ import annotations

from fractions import Fraction
from typing import TYPE_CHECKING

from flint import arb

from cdobs_cli.certificate import CONVERGENCE, ERROR_BOUNDED, Bound, Check, Claim, Status, status_of
from cdobs_cli.certify.accuracy import acting_text
from cdobs_cli.certify.definite import eigenvalue_range
from cdobs_cli.certify.methods.base import UNREADABLE
from cdobs_cli.design import Design
from cdobs_cli.exact.functions import fraction_ball
from cdobs_cli.exact.numbers import lower_text, text_below, upper_text
from cdobs_cli.families.updated_sampling.carried import errors
from cdobs_cli.families.updated_sampling.carried.law import Law
from cdobs_cli.families.updated_sampling.carried.observer import observer
from cdobs_cli.families.updated_sampling.carried.proof import Floor, floor, least_eigenvalue
from cdobs_cli.families.updated_sampling.carried.slopes import largest_slopes
from cdobs_cli.families.updated_sampling.carried.typed import stored_law
from cdobs_cli.families.updated_sampling.claims import bounded_claim
from cdobs_cli.families.updated_sampling.lipschitz import Rate, largest_is_proved, rate_claim, stored_rate
from cdobs_cli.hybrid import Observer
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.updated_sampling import UpdatedSampling

SOURCE = "cdobs, Riccati inequality carried online"
FLOOR = "carried.floor"
_HOW = "Riccati comparison, LDL' in balls over pieces of [0, T_min]"
_ENTRIES = "triangular"  # c bounds every slope by itself, whichever entries there are


def as_run(family: UpdatedSampling, plant: Plant, design: Design) -> Observer:
    """The observer of a stored design. Raises: KeyError, ValueError where it holds no law of this plant."""
    rate = stored_rate(family, plant, design)
    law, largest = stored_law(family, design), largest_slopes(plant, rate)
    if largest is None or not law.fits(plant.n, plant.p, tuple(largest)):
        raise ValueError("its law does not fit the plant")
    return observer(plant, law, rate, largest)


def certify(family: UpdatedSampling, plant: Plant, design: Design) -> Check:
    """The premises, the floor, convergence with its rate, and the error under what is declared."""
    if design.outcome == "none":
        return Check(_consequences(plant, design.reason or "there is no law"))
    try:
        rate, law = stored_rate(family, plant, design), stored_law(family, design)
    except UNREADABLE as error:
        return Check(_consequences(plant, f"the stored design cannot be read: {error}"))
    premise = rate_claim(plant, rate, _ENTRIES)
    bounded = largest_is_proved(plant, rate, _ENTRIES, premise)
    largest = largest_slopes(plant, rate)
    found = Floor(False) if largest is None else floor(plant, law, largest)
    stands = bounded and premise.status == "proved" and found.holds
    claims = (
        premise,
        bounded_claim(rate, bounded, "Pi falls no faster than at that c"),
        _floor_claim(rate, law, found),
    )
    if not stands or found.share is None or largest is None:
        return Check((*_consequences(plant, None), *claims))
    bounds = {
        "guaranteed_period": Bound(text_below(law.T_min), None, "s", "carried", _period_text(rate)),
        "decay_rate": Bound(lower_text(_rate(law), 9), None, "1/s", "carried", "every c(t) within its bound"),
        **errors.bounds(plant, law, largest, found.share),
    }
    conclusion = Claim(
        CONVERGENCE, "consequence", "proved", _CONVERGES.format(lower_text(_rate(law), 6)), SOURCE, required=True,
        method="carried", by=FLOOR,
    )  # fmt: skip
    told = (conclusion, *_bounded(plant, bounds), *claims)
    return Check(told, bounds, envelope=_envelope(law, found.share))


_CONVERGES = "x_hat - x falls like exp(-{} t), for every plant of the class with this c, jumps of c included."
_OPEN = "x_hat - x tends to 0 for every plant of the class with this c"


def _rate(law: Law) -> arb:
    return arb(law.sigma.scalar) * arb(law.idle.scalar)


def _period_text(rate: Rate) -> str:
    return f"every time between samples while c <= {rate.largest}"


def _consequences(plant: Plant, why: str | None) -> tuple[Claim, ...]:
    """Those that stay open."""
    text = f"{_OPEN}: {why}." if why else f"{_OPEN}."
    open_ = Claim(CONVERGENCE, "consequence", "undecided", text, SOURCE, required=True)
    return (open_, *_bounded(plant, {}))


def _bounded(plant: Plant, bounds: dict[str, Bound]) -> tuple[Claim, ...]:
    if not plant.is_perturbed:
        return ()
    names = [name for name in bounds if name.partition(".")[0] in ("error", "rms")]
    under = f"Under {acting_text(plant)} the error stays bounded"
    if not names:
        return (Claim(ERROR_BOUNDED, "consequence", "undecided", f"{under}.", SOURCE, required=True),)
    left = ", ".join(f"{_left(name)} <= {bounds[name].proved}" for name in names)
    return (
        Claim(
            ERROR_BOUNDED, "consequence", "proved", f"{under}: {left}, whenever the observer samples.", SOURCE,
            required=True, method="carried", by=names[0],
        ),
    )  # fmt: skip


def _left(name: str) -> str:
    head, _, state = name.partition(".")
    return "rms(e)" if head == "rms" else f"|e_{state}|"


def _floor_claim(rate: Rate, law: Law, found: Floor) -> Claim:
    """Pi >= zeta F for every c(t), and no sample before T_min."""
    T, became = law.T_min, status_of(found.holds)
    every = f"for every c(t) <= {rate.largest}, jumps included"
    if found.share is not None and found.holds:
        share = float(found.share)
        least = fraction_ball(found.share) * least_eigenvalue(law.F.balls())
        text = f"Pi >= {share:g} F > 0 {every}, and no sample is due before T_min = {T}"
        return _certificate(became, text, lower_text(least, 6))
    return _certificate(became, f"Pi keeps a floor {every}, with T_min = {T}: {_why_open(found, T)}", None)


def _certificate(became: Status, text: str, margin: str | None) -> Claim:
    return Claim(FLOOR, "certificate", became, f"{text}.", SOURCE, margin=margin, method=_HOW)


def _why_open(found: Floor, T: object) -> str:
    if not found.fits:
        return "the law does not fit the plant (shapes, signs, theta < 1, idle <= 1)"
    if not found.positive:
        return "F > 0 is not proved"
    if not found.kept:
        return f"at c at its largest, Pi is not above F {T} after a sample; a shorter T_min, or a smaller F, may do"
    return "Pi > 0 is not proved on all of [0, T_min]; a shorter T_min may do"


def _envelope(law: Law, share: Fraction) -> dict[str, str]:
    """|e(t)| <= factor |e(0)| exp(-rate t): Pi(0) = F, and Pi >= zeta F later."""
    F = law.F.balls()
    low, high = least_eigenvalue(F), arb(eigenvalue_range(F, smallest=False).high)
    if not low > 0:
        return {}
    factor = (high / (low * fraction_ball(share))).sqrt()
    return {"factor": upper_text(factor, 9), "rate": lower_text(_rate(law), 9)}
