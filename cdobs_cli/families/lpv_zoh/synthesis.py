"""The verb `synthesize`: a gain, and a certificate for each period and rate worth proving."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from cdobs_cli.certify.lmi import solver_log, summary
from cdobs_cli.certify.unseen import unseen
from cdobs_cli.design import Design
from cdobs_cli.families.lpv_zoh import printed_search
from cdobs_cli.families.lpv_zoh.corners import MOST_CORNERS
from cdobs_cli.families.lpv_zoh.curve import Curve, gain_curve
from cdobs_cli.families.lpv_zoh.gains import NoDesignError, given, search
from cdobs_cli.families.lpv_zoh.ladder import beyond_any_gain, certificates, headline
from cdobs_cli.families.lpv_zoh.laws import at_period
from cdobs_cli.plant import Plant

if TYPE_CHECKING:
    from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold


def synthesize(family: LpvZeroOrderHold, plant: Plant, effort: int) -> Design:
    """The design: the given gain or one found for the objective, with its certificates."""
    corners = 2 ** len(plant.slopes.uncertain)
    if corners > MOST_CORNERS:
        reason = f"the slope box has {corners} corners, at most {MOST_CORNERS} are taken: declare fewer slopes that vary"
        return Design(family.family, "none", plant.sampling, {}, reason=reason)
    hidden = unseen(plant)
    if hidden is not None and (family.gain is None or hidden.period is None):  # nothing to look for
        if family.gain is not None:
            return Design(family.family, "given", plant.sampling, {"L": family.gain.L})
        return Design(family.family, "none", plant.sampling, {}, reason=hidden.sentence(plant))
    with solver_log() as records:
        try:
            found = given(family, plant, effort) if family.gain is not None else search(family, plant, effort)
            if float(found.T) < float(plant.sampling.T_max):
                raise NoDesignError(f"the longest period found is {found.T}, below the least acceptable {plant.sampling.T_max}")
        except NoDesignError as none:
            beyond = beyond_any_gain(plant, None, effort)
            return Design(family.family, "none", plant.sampling, {}, beyond, summary(records), reason=str(none))
        law = plant.sampling.with_period(found.T)
        made = certificates(family, at_period(plant, found.T), found.L, effort)
        proved = max((float(c.sampling.T_max) for c in made if c.method != printed_search.METHOD), default=None)
        # The curve of period against rate belongs to a search; effort 0 is for a quick answer.
        searched = family.gain is None and effort > 0
        curve = gain_curve(plant, found.L, found.T, headline(plant, effort)) if searched else Curve()
        details: dict[str, Any] = {"curve": curve.document()} if searched else {}
        made += tuple(c for c in curve.longest if proved is None or float(c.sampling.T_max) > proved)
        made += beyond_any_gain(plant, proved, effort)
    outcome: Any = "given" if family.gain is not None else "found"
    return Design(family.family, outcome, law, {"L": found.L}, made, summary(records), details=details)
