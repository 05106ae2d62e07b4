"""Claims, certificates, witnesses, bounds: what `check` says, and what it says it about."""

from __future__ import annotations

from dataclasses import field
from typing import Any, Literal, Self

from cdobs_cli.codec import KEY, OPTIONAL, Artefact, Noun
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

Status = Literal["proved", "refuted", "undecided"]
ClaimKind = Literal["premise", "assumption", "certificate", "consequence", "printed"]
About = Literal["class", "plant"]
Better = Literal["more", "less"]
CONVERGENCE = "convergence"  # the claim that the verdict is about
ERROR_BOUNDED = "error_bounded"  # and, where disturbance or noise is declared, this one
UNDER_NOISE = "estimate_under_noise"  # the premise of that one: the estimate stays where the slopes hold


def status_of(holds: bool) -> Status:
    """What is said of something that is proved or left open."""
    return "proved" if holds else "undecided"


@dataclass(frozen=True)
class Witness(Noun):
    """A counterexample that anyone can replay.

    kind: `constant` (one slope vector), `switching` (slope values per arc), `vector` (a state or error
    vector), `point` (a point of the domain), `box` (a box of x(0) and a word of sampling periods, with what
    acts on the run in `data`). `times` are arc lengths or sampling periods (decimal strings),
    `values` one list of decimal strings per arc (order: `entries`), `multiplier` the proved growth per
    period as text. `about`: does it defeat the class of slopes, or the typed plant?
    """

    kind: Literal["constant", "switching", "vector", "point", "box", "noise"]
    about: About = field(metadata={KEY: "class"})
    times: tuple[str, ...] = ()
    values: tuple[tuple[str, ...], ...] = ()
    multiplier: str | None = None
    entries: tuple[tuple[int, int], ...] = ()
    data: dict[str, Any] = field(default_factory=dict, metadata={OPTIONAL: True})


@dataclass(frozen=True)
class Claim(Noun):
    """One statement and what became of it.

    `margin` is a decimal string on the safe side: how far the deciding quantity is from its limit.
    `by` names the certificate that a consequence rests on. Required are the slope premises, that phi is
    defined, and the consequence `convergence`. An `assumption` is the user's to answer for where it is not
    proved; it is named in the verdict, and never required.
    """

    id: str
    kind: ClaimKind
    status: Status
    statement: str
    source: str
    required: bool = False
    margin: str | None = None
    method: str | None = None
    by: str | None = None
    witness: Witness | None = None


@dataclass(frozen=True)
class Bound(Noun):
    """A bracket: decimal strings rounded to the safe side, "inf" allowed, None where nothing is known.

    `better`: whether a larger or a smaller proved end says more. Of periods more is better, and a shortened
    proved end is rounded down; of widths and errors less, and it is rounded up. The refuted end goes the other way.
    """

    proved: str | None = None
    refuted: str | None = None
    unit: str = "s"
    method: str | None = None
    about: str | None = None
    better: Better = "more"


@dataclass(frozen=True)
class Certificate(Noun):
    """What a search found and a proof can re-read: `data` holds matrices as rows of decimal strings, and
    plain numbers as decimal strings."""

    method: str
    sampling: SamplingLaw
    data: dict[str, Any]


@dataclass(frozen=True)
class Check(Artefact):
    """All claims and bounds of one spec with one design. time_unit: the label of the bounds' time, empty for `s`.

    envelope: `factor` and `rate` of |e(t)| <= factor |e(0)| exp(-rate t), decimal strings, where one is proved.
    """

    claims: tuple[Claim, ...]
    bounds: dict[str, Bound] = field(default_factory=dict)
    digests: dict[str, str] = field(default_factory=dict)
    time_unit: str = field(default="", metadata={OPTIONAL: True})
    envelope: dict[str, str] = field(default_factory=dict, metadata={OPTIONAL: True})

    @property
    def verdict(self) -> Status:
        """refuted if a required claim is, else proved if all of them are (and there is one), else undecided."""
        required = [claim.status for claim in self.claims if claim.required]
        if "refuted" in required:
            return "refuted"
        return "proved" if required and all(status == "proved" for status in required) else "undecided"

    def claim(self, identifier: str) -> Claim | None:
        return next((claim for claim in self.claims if claim.id == identifier), None)

    def document(self) -> dict[str, Any]:
        """With the verdict that follows."""
        return super().document() | {"verdict": self.verdict}

    @classmethod
    def from_document(cls, document: dict[str, Any]) -> Self:
        """Raises: KeyError, TypeError, ValueError on anything `document` did not write."""
        stored = dict(document)
        verdict = stored.pop("verdict")
        check = super().from_document(stored)
        if verdict != check.verdict or not any(claim.required for claim in check.claims):
            raise ValueError("a verdict that does not follow from the claims")
        for bound in check.bounds.values():
            for end in (bound.proved, bound.refuted):
                if end is not None and end.removeprefix("-") != "inf":
                    Exact(end)
        if check.envelope and not check.envelope.keys() == {"factor", "rate"}:
            raise ValueError("an envelope has a factor and a rate")
        for text in check.envelope.values():
            Exact(text)
        return check
