"""What a search for a gain gives: a candidate, or the reason why there is none."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from cdobs_cli.certify import search
from cdobs_cli.certify.methods.base import Method, Question
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.records import dataclass
from cdobs_cli.sampling import SamplingLaw

_HALVINGS = 10
# How large the error of a question's gain stays, the smaller the better; None where nothing is proved.
Merit = Callable[[Question], float | None]


class NoDesignError(Exception):
    """No gain was found; the message says how far the search went."""


@dataclass(frozen=True)
class Candidate:
    """A gain as it is run, for a law, and where one is known already its certificate; the largest merit wins."""

    gain: ExactMatrix
    law: SamplingLaw
    merit: float = 0.0
    method: Method | None = None

    @staticmethod
    def of(met: tuple[ExactMatrix, Method] | None, merit: float | None = None) -> Candidate | None:
        """A gain with its certificate; its merit is its period where none is said."""
        if met is None:
            return None
        gain, method = met
        return Candidate(gain, method.law, float(method.law.period) if merit is None else merit, method)


class GainSearch:
    """One way of finding a gain. Each verb returns None, or raises NoDesignError, where it finds none."""

    def at(self, question: Question) -> Candidate | None:
        """A gain for the question's law."""
        return None

    def longest(self, question: Question) -> Candidate | None:
        """The gain of the longest period; the question's own is the least acceptable."""
        return None

    def nearest(self, question: Question) -> Candidate | None:
        """Where there is none at the question's law: a gain of a shorter period, by halves."""
        for _ in range(_HALVINGS):
            question = question.at(search.short(float(question.law.period) / 2, 6))
            try:
                candidate = self.at(question)
            except NoDesignError:
                continue
            if candidate is not None:
                return candidate
        return None

    def fastest(self, question: Question) -> Candidate | None:
        """The gain of the largest rate under the question's law."""
        return None

    def quietest(self, question: Question) -> Candidate | None:
        """Of the gains that reach half of the fastest proved rate the one that amplifies measurement noise least."""
        return None

    def least_error(
        self, question: Question, merit: Merit | None = None, weights: Sequence[float] | None = None,
        near: ExactMatrix | None = None,
    ) -> Candidate | None:  # fmt: skip
        """The gain of the least proved error under the noise and disturbance that are declared, at the question's rate
        at least. merit: what the last steps of a search minimise. weights: of each e_i^2; 1 / scale_i^2 where they are
        not said. near: a gain that a search which needs a start may start from."""
        return None
