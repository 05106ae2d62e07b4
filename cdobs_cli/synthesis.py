"""A design made of a spec, its slopes found and its estimate confined; and whether a stored one is a design of it."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

from flint import arb

from cdobs_cli import progress
from cdobs_cli.bounds.estimate import before_the_first_sample
from cdobs_cli.bounds.joint import joint_slopes
from cdobs_cli.bounds.slopes import is_shared, resolve, to_be_found, unbounded_claims, with_found
from cdobs_cli.certificate import CONVERGENCE, Check, Claim
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import Exact, upper_text
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Box, Plant

if TYPE_CHECKING:
    from cdobs_cli.spec.model import Spec

# Room for a transient that grows as the slopes over a wider domain do.
_SPARE = 1.5
# Of the width of the domain: how far its slopes are looked at beyond it where no initial error is typed.
_PART = Exact("1/256")


def initial_errors(spec: Spec) -> Box | None:
    """The typed x_hat(0) - x(0), where the estimate may have to be shown to stay near the domain, or an error from
    there is to be bounded."""
    saturate = getattr(spec.observer, "saturate", None)
    if spec.simulation is None or saturate is None:
        return None
    if not spec.plant.has_bounded and (not spec.plant.domain or saturate is True):
        return None
    return spec.simulation.initial_errors(spec.plant.n)


def plant_of(spec: Spec, design: Design) -> Plant:
    """The plant with the slopes that the design found where they are `auto`; as it is where it found none."""
    return with_found(spec.plant, design.slopes) if design.slopes else spec.plant


def system_of(spec: Spec, design: Design) -> HybridSystem:
    """Plant and observer as they run."""
    plant = plant_of(spec, design)
    original = None if spec.coordinates is None else spec.coordinates.original
    observer = spec.observer.observer_as_run(plant, design)
    return HybridSystem(plant, observer, design.estimate.way == "open", original)


def new_design(spec: Spec, effort: int) -> Design:
    """A design, with what is worth knowing of it."""
    from cdobs_cli.certify.lmi import solver_log, summary

    with solver_log() as records:
        design = _kept(spec, effort)
        finished = (
            design if design.outcome == "none" else spec.observer.finished(plant_of(spec, design), design, effort)
        )
    return replace(finished, solver=summary(records), cut=progress.is_late())


def _kept(spec: Spec, effort: int) -> Design:
    """The design that is kept. Where automatic slopes share functions: the one whose entries move together, if its
    estimate is shown to stay for the typed initial errors (and no longer period is in sight where one is asked for);
    else the better of that one, for initial errors of its own, and of the one whose entries move by themselves, which
    the continuation serves."""
    plant = spec.plant
    if not plant.is_to_be_found:
        return _design_over(plant, spec, effort)
    glance = _at_a_glance(spec, effort)
    wants_more = effort and getattr(spec.observer, "objective", None) == "max_period"
    other = _apart(spec, 0) if glance is not None and wants_more else None
    if glance is not None and other is not None and _is_longer(other, glance.design):
        apart = _apart(spec, effort)
        if _is_longer(apart, glance.design):
            return apart
    together = None if glance is None else glance.refined(spec, effort)
    if together is not None and (together.estimate.way == "everywhere" or _holds_from_start(spec, together)):
        return together
    if together is not None and other is not None and _is_longer(together, other):
        return together
    apart = _apart(spec, effort)
    if together is None:
        return apart
    if _reaches(spec, apart) and not (_serves(together) and _says_more(spec, together, apart)):
        return apart
    # Where neither serves, what is said is said of the smaller class.
    return together


def _serves(design: Design) -> bool:
    return design.outcome != "none" and design.estimate.way != "open"


def _reaches(spec: Spec, design: Design) -> bool:
    """Whether it serves, and does what was asked, or at least converges under the law that was."""
    if not _serves(design) or design.outcome != "short":
        return _serves(design)
    return spec.observer.certify(plant_of(spec, design), design, 0).verdict == "proved"


def _holds_from_start(spec: Spec, design: Design) -> bool:
    """Whether the estimate stays within a margin for the initial errors that are typed."""
    start = initial_errors(spec)
    if start is None or design.estimate.way != "margin":
        return False
    held = design.estimate.initial_errors
    ends = zip(held.lower, start.lower, start.upper, held.upper, strict=True)
    return all(low.is_at_most(below) and above.is_at_most(high) for low, below, above, high in ends)


def _is_longer(design: Design, other: Design) -> bool:
    """Whether it serves, for longer periods."""
    return _serves(design) and float(design.sampling.period) > float(other.sampling.period)


def _says_more(spec: Spec, design: Design, other: Design) -> bool:
    """Whether the first is for longer periods under max_period; of a given gain, whether it alone is proved."""
    if design.outcome == "given":
        first, second = (spec.observer.certify(plant_of(spec, one), one, 0).verdict for one in (design, other))
        return first == "proved" != second
    return _is_longer(design, other) and getattr(spec.observer, "objective", None) == "max_period"


class _Glance(NamedTuple):
    """A design for slopes that move together, found with this effort, and the region that they are found over."""

    design: Design
    region: Plant
    effort: int

    def refined(self, spec: Spec, effort: int) -> Design:
        """With all of the effort."""
        if self.effort >= effort or progress.is_late():
            return self.design
        final = _design_over(self.region, spec, effort, together=True)
        return self.design if progress.is_late() and not _serves(final) else final


def _at_a_glance(spec: Spec, effort: int) -> _Glance | None:
    """How wide a margin of the domain the estimate needs, and whether one serves, is seen with little effort; None
    where slopes share nothing."""
    saturate = getattr(spec.observer, "saturate", None)
    if saturate in (None, True) or joint_slopes(spec.plant) is None:
        return None
    if initial_errors(spec) is None:
        region = spec.plant.widened(_part_of_domain(spec.plant))
        return _Glance(_design_over(region, spec, effort, together=True), region, effort)
    taken = 0
    design = _design_over(spec.plant, spec, taken, together=True)
    if design.outcome == "none" and effort:
        taken = effort
        design = _design_over(spec.plant, spec, taken, together=True)
    if design.outcome == "none":
        return _Glance(design, spec.plant, effort)
    if _serves(design):
        return _Glance(design, spec.plant, taken)
    margin = _margin_needed(spec, design)
    region = spec.plant.widened(margin)
    wider = _design_over(region, spec, 0, together=True) if margin else design
    return _Glance(wider, region, 0) if _serves(wider) else _Glance(design, spec.plant, effort)


def _part_of_domain(plant: Plant) -> dict[str, Exact]:
    """A margin for initial errors that nobody typed."""
    ends = ((name, box.lower, box.upper) for name, box in plant.domain.box.items())
    return {name: (high - low) * _PART for name, low, high in ends if low is not None and high is not None}


def _apart(spec: Spec, effort: int) -> Design:
    """The design for slopes that move by themselves: of the regions that they may be found over the first that leaves
    the estimate room, else the one for the domain itself."""
    plant, saturate = spec.plant, getattr(spec.observer, "saturate", False)
    # With affine limits the continuation needs slopes on the whole box: wherever the estimate goes, that one serves.
    if plant.domain.where and saturate is not False:
        design = _design_over(plant.on_box, spec, effort)
        if design.outcome != "none":
            return design
    design = _design_over(plant, spec, effort)
    if design.outcome == "none" or design.estimate.way != "open":
        return design
    margin = {} if saturate is True else _margin_needed(spec, design)
    wider = _design_over(plant.widened(margin), spec, effort) if margin else design
    return wider if _serves(wider) else design


def _design_over(region: Plant, spec: Spec, effort: int, *, together: bool = False) -> Design:
    """A design, its automatic slopes found over the domain of `region`, with what the solver was asked for it."""
    from cdobs_cli.certify.lmi import ran_out, solver_log

    plant, observer = spec.plant, spec.observer
    slopes: dict[str, tuple[str, str]] = {}
    if plant.is_to_be_found:
        resolved, slopes = resolve(plant, together=together, over=region)
        if resolved.is_to_be_found:
            reason = "; ".join(claim.statement for claim in unbounded_claims(resolved))
            return Design(observer.name, "none", plant.sampling, {}, reason=reason)
        plant = with_found(plant, slopes)
    with solver_log() as records:
        design = observer.synthesize(plant, effort)
    lost = ran_out(records) if design.outcome in ("none", "short") else None
    told = design.reason if lost is None else f"{design.reason}; {lost}"
    design = replace(design, slopes=slopes, reason=told)
    if design.outcome == "none":
        return design
    start = initial_errors(spec)
    if start is not None:
        from_start = observer.bounds_from(plant, design, start, effort)
        design = replace(design, certificates=(*design.certificates, *from_start))
    return replace(design, estimate=observer.confine(plant, design, start))


def _margin_needed(spec: Spec, design: Design) -> dict[str, Exact]:
    """How far the estimate goes beyond the domain, with some room; empty where no level set shows it."""
    start = initial_errors(spec)
    plant, family = plant_of(spec, design), spec.observer
    transients = (family.noisy_transients(plant, design) or family.transients(plant, design)) if start else ()
    if start is None or not transients:
        return {}
    bounds = min((transient(start) for transient in transients), key=lambda ends: max(float(end) for end in ends))
    bounds = tuple(map(arb.max, bounds, before_the_first_sample(spec.plant, start)))
    if not all(bound.is_finite() for bound in bounds):
        return {}
    names = spec.plant.states
    return {name: Exact(upper_text(bound * _SPARE, 3)) for name, bound in zip(names, bounds, strict=True)}


def certify(spec: Spec, design: Design, effort: int) -> Check:
    """What is proved of a design, with the premises about the plant and the conditions of the verdict."""
    from cdobs_cli.bounds.estimate import confinement_claim, noisy_confinement_claim
    from cdobs_cli.bounds.slopes import slope_claims
    from cdobs_cli.certify.conditions import proved_of_the_plant, with_conditions

    family, plant = spec.observer, plant_of(spec, design)
    if spec.plant.is_to_be_found and not design.slopes:
        statement = f"The error converges: {design.reason or 'there is no design'}."
        convergence = Claim(CONVERGENCE, "consequence", "undecided", statement, family.source, required=True)
        return Check((convergence, *unbounded_claims(resolve(spec.plant)[0])))
    proved, premises = family.certify(plant, design, effort), slope_claims(plant)
    if plant.domain and design.outcome != "none":
        within = design.estimate.way == "margin"  # the other ways ask for no transient
        noisy = tuple(family.noisy_transients(plant, design)) if within else ()
        free = tuple(family.transients(plant, design)) if within else ()
        premises += (confinement_claim(plant, design.estimate, (*noisy, *free)),)
        if plant.is_perturbed:
            premises += (noisy_confinement_claim(plant, design.estimate, noisy),)
    if spec.coordinates is not None:
        premises = spec.coordinates.premises(premises)
    domain = spec.typed.domain if spec.typed else plant.domain
    claims = with_conditions(
        (*premises, *proved.claims), plant, design.estimate, domain, disturbed=family.disturbed,
        reason=design.reason if design.outcome == "short" else None,
    )  # fmt: skip
    judged = replace(proved, claims=claims)
    return replace(judged, bounds=proved_of_the_plant(judged, design.sampling, design.estimate))


def is_design_of(spec: Spec, stored: Design) -> bool:
    """Whether a stored design holds what the spec gives, makes an observer, and is for the sampling law that the spec
    asks for (under max_period: that law at the same period or a longer one)."""
    if stored.family != spec.observer.name or not _holds_what_is_given(spec, stored):
        return False
    if stored.outcome != "none":
        try:
            system_of(spec, stored)
        except Exception:  # whatever a matrix of another shape, or a text that is no number, comes to
            return False
    asked, law = spec.plant.sampling, stored.sampling
    if law == asked:
        return True
    longer = (law.period - asked.period).sign() == 1 and law == asked.with_period(law.period)
    return longer and getattr(spec.observer, "objective", None) == "max_period"


def _holds_what_is_given(spec: Spec, stored: Design) -> bool:
    """Whether the gains, the feedback and the options that the spec types are those of the design, and the slopes
    those that it leaves to be found."""
    given = spec.observer.given()
    if not all(letter in given and given[letter] in (None, matrix) for letter, matrix in stored.gain.items()):
        return False
    if stored.outcome == "none":
        return True
    typed = spec.observer.is_given
    alone = {name for name in stored.slopes if not is_shared(name)}  # `system_of` reads the others
    if (stored.outcome == "given") != typed or alone != {name for name, *_ in to_be_found(spec.plant)}:
        return False
    return given.keys() == stored.gain.keys() and _is_confined_as_typed(spec, stored)


def _is_confined_as_typed(spec: Spec, stored: Design) -> bool:
    """Whether the estimate is kept where the slopes hold in a way that the family has and `saturate` leaves (that it
    is kept is proved by `check`)."""
    way, saturate = stored.estimate.way, getattr(spec.observer, "saturate", False)
    if way == "cut":
        return spec.observer.confine(spec.plant, replace(stored, certificates=()), None).way == "cut"
    return (way, saturate) not in (("continuation", False), ("margin", True))
