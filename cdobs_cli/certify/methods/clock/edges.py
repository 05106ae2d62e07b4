"""How far the clock certificate reaches for one gain, in the period and in the rate: Newton's steps on the largest
margin with its derivatives, shape by shape, and a proof close to where the finest ends.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction

from cdobs_cli.certify import search
from cdobs_cli.certify.ascent import Height, end
from cdobs_cli.certify.methods.base import Question
from cdobs_cli.certify.methods.clock.certificate import Clock, serves, shapes
from cdobs_cli.certify.methods.clock.form import Shape
from cdobs_cli.certify.methods.clock.slope import slope

_WIDTHS = (1e-3, 2e-4, 5e-5, 1e-5)  # relative, by effort
_BACK = (0, 1, 4, 16, 64)  # so many widths inside of the end a proof is tried
_SPAN = 1e5  # down from the question's period
_DIGITS = 6
_COARSE = 2e-3
_STEP, _FINER_STEP = 1.0, 0.1


def longest(question: Question, share: float = 0.0) -> Clock | None:
    """The certificate of the longest period found for the question's gain, at the question's rate and at least the
    rate `share` over the period."""
    start = float(question.law.T_max)
    shortest = 0.0 if question.law.is_periodic else float(question.law.T_min) * (1 + _COARSE)

    def about(T: float) -> Question:
        return at_period(question, T, share)

    def of(shape: Shape) -> Callable[[float], Height | None]:
        return lambda T: height_in_period(about(T), shape, share)

    return _reached(about, of, start, max(start / _SPAN, shortest), _WIDTHS[question.level])


def fastest(question: Question, width: Fraction) -> Clock | None:
    """The certificate of the largest rate found for the question's gain, to a relative width. The margin is convex in
    sigma: from 0 on Newton's steps end where it does."""

    def of(shape: Shape) -> Callable[[float], Height | None]:
        return lambda sigma: height_in_rate(at_rate(question, sigma), shape)

    return _reached(lambda sigma: at_rate(question, sigma), of, 0.0, 0.0, float(width))


def _reached(
    about: Callable[[float], Question],
    of: Callable[[Shape], Callable[[float], Height | None]],
    start: float,
    least: float,
    width: float,
) -> Clock | None:
    """From about the end of each shape to that of the next, finer one, while that goes further; then close to the end
    of the last, and its proof."""
    best: tuple[float, Shape] | None = None
    step, coarse = _STEP, max(_COARSE, width)
    for shape in _serving(about(start)):
        value = end(of(shape), start, coarse, step, least)
        if value is None:
            continue
        further = best is None or value > best[0] * (1 + coarse)
        if best is None or value > best[0]:
            best, start, step = (value, shape), value, _FINER_STEP
        if not further:
            break
    if best is None:
        return None
    value, shape = best
    if width < coarse:
        value = end(of(shape), value, width, step, least) or value
    for back in _BACK:
        inside = about(value * (1 - back * width))
        certificate = Clock.guess(inside, shape)
        if certificate is not None and certificate.prove(inside).holds:
            return certificate
    return None


def _serving(question: Question) -> list[Shape]:
    """The schedule from the first shape on that serves the question: those before end earlier; all where none does."""
    schedule = list(shapes(question))
    serving = (k for k, shape in enumerate(schedule) if serves(question, shape))
    return schedule[next(serving, 0) :]


def at_period(question: Question, T: float, share: float) -> Question:
    """At another period, and at the rate `share` over it at least."""
    period = search.short(T)
    about = question.at(period)
    if not share:
        return about
    return about.with_rate(max(question.rate, search.short(share / T, _DIGITS).rational or Fraction(0)))


def at_rate(question: Question, sigma: float) -> Question:
    return question.with_rate(search.short(sigma, _DIGITS).rational or Fraction(0))


def height_in_period(question: Question, shape: Shape, share: float = 0.0, letter: str | None = None) -> Height | None:
    """The margin by the gain's entries and by T_max; the rate falls with the period where it is `share` over it."""
    met = slope(question, shape, letter)
    if met is None:
        return None
    T = float(question.law.T_max)
    falls = share and float(question.rate) * T <= share * (1 + 1e-5)
    by_period = met.by_period - (share / T**2 * met.by_rate if falls else 0.0)
    return Height(met.margin, met.by_gain.reshape(-1), by_period)


def height_in_rate(question: Question, shape: Shape, letter: str | None = None) -> Height | None:
    """The margin by the gain's entries and by sigma."""
    met = slope(question, shape, letter)
    if met is None:
        return None
    return Height(met.margin, met.by_gain.reshape(-1), met.by_rate)
