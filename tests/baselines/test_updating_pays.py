"""On an unstable plant with c(x_hat, u) that varies, updating saves measurements at equal error."""

from __future__ import annotations

from updating import Comparison, fewest, front


def test_updating_needs_fewer_measurements_than_the_best_constant_period():
    comparison = Comparison(runs=4, horizon="14")
    points = [comparison.updated("0.9", "0.3"), comparison.updated("0.9", "0.1")]
    points += [
        comparison.constant(period, radius) for period in ("0.15", "0.25", "0.35") for radius in (0.5, 0.7, 0.85)
    ]
    best = front(points, "updated")[-1]
    rival = fewest(points, "constant period", best.error)
    assert rival is None or rival.measurements > 1.2 * best.measurements


def test_without_measurements_the_error_grows():
    comparison = Comparison(runs=4, horizon="14")
    blind = comparison.constant("13.9", 1.0)
    assert blind.error > 10 * comparison.updated("0.9", "0.3").error


def test_noise_reaches_the_estimate_in_proportion():
    quiet, loud = (
        Comparison(runs=2, horizon="14", noise=noise).updated("0.9", "0.3").error for noise in ("0.003", "0.03")
    )
    assert 3 * quiet < loud < 15 * quiet


# Its floor is proved for every c(t) up to 10.
ACCURATE = {"law": {"T_min": "0.15", "sigma": "0.1", "theta": "0.1", "share": "0.25"}}


def test_a_carried_certificate_needs_few_measurements_beside_theorem_2_prime():
    comparison = Comparison(runs=8, horizon="30")
    met = comparison.carried(**ACCURATE)
    assert met is not None  # and so it is proved
    point, observer = met
    assert point.measurements <= 50 and point.error <= 0.0105 and point.worst <= 1.5 * point.error
    theorem = comparison.proved()
    assert theorem.measurements > 8 * point.measurements and theorem.error > 10 * point.error
    # Honestly: the filter, which knows the noise, is better at the same instants.
    assert comparison.kalman_at_the_same(observer, "1e-8").error < point.error
