"""Sensors that send on change in simulations: instants, which sensor, noise, comparisons, and what is kept."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from loops import box, plan, plant

from cdobs_cli.design import Design
from cdobs_cli.errors import SpecError
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.families.reachability.observer import observer
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Plant
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate.archive import from_bytes, to_bytes
from cdobs_cli.simulate.engine import simulate
from cdobs_cli.thresholds import Threshold


def law(*deltas, every=None):
    thresholds = [Threshold(f"s{k}", k, Exact(delta)) for k, delta in enumerate(deltas)]
    return SamplingLaw.on_change(thresholds, None if every is None else Exact(every))


def system(about: Plant, K) -> HybridSystem:
    return HybridSystem(about, observer(about, Design("reachability", "given", about.sampling, {"K": ExactMatrix(K)})))


def growing(sampling, **further) -> Plant:
    """xdot = x / 2."""
    return plant(("x",), [["0.5"]], law=sampling, **further)


def turning(sampling, **further) -> Plant:
    return plant(("x", "y"), [["0.1", "1"], ["-1", "0.1"]], law=sampling, **further)


@pytest.mark.parametrize("runs", [1, 3])
def test_instants_agree_with_the_closed_form(runs):
    """e+ = e / 2 at |e| = 1/4, which grows back in 2 log 2; at 0 corrections follow until |e| is below 1/4."""
    about = growing(law("0.25"))
    run = simulate(system(about, [["0.5"]]), plan("8", [1], [0], runs=runs), about.sampling)
    for path in run.trajectories:
        assert path.t_k == pytest.approx(2 * np.log(2) * np.arange(1 + int(8 / (2 * np.log(2)))), rel=1e-11)
        assert path.y_k[:, 0] == pytest.approx(np.exp(path.t_k / 2), rel=1e-9)
        error = np.abs(path.estimates["x_hat"] - path.x)[:, 0]
        assert error[0] == 1 and error[1:].max() == pytest.approx(0.25, rel=1e-9)
    assert all(one.measurements == len(run.trajectories[0].t_k) for one in run.summaries)


@pytest.mark.parametrize("runs", [1, 3])
def test_comparisons_at_multiples(runs):
    about = growing(law("0.25", every="0.3"))
    run = simulate(system(about, [["1"]]), plan("8", [1], ["0.9"], runs=runs), about.sampling)
    for path in run.trajectories:
        # From 0.1 on |e| passes 1/4 at 1.83, which is seen at 2.1: there is nothing left to grow then.
        assert path.t_k == pytest.approx([2.1], rel=1e-12)
        error = np.abs(path.estimates["x_hat"] - path.x)[:, 0]
        assert error.max() == pytest.approx(0.1 * np.exp(1.05), rel=1e-9) and error[-1] == pytest.approx(0, abs=1e-9)


def test_which_sensor_sends_is_kept():
    about = turning(law("0.1", "0.2"), C=[[1, 0], [0, 1]])
    run = simulate(system(about, [["1", "0.2"], ["0.3", "1"]]), plan("20", [1, 0.5], [0, 0]), about.sampling)
    path = run.trajectories[0]
    sent = ~np.isnan(path.y_k)
    assert (sent.sum(axis=1) == 1).all() and sent.any(axis=0).all() and np.all(np.diff(path.t_k) >= 0)
    # Each sends once at an instant, whatever the corrections that follow one another.
    assert path.t_k[:2] == pytest.approx([0, 0]) and sent[0].tolist() != sent[1].tolist() and path.t_k[2] > 0
    late = path.t > 0
    residuals = np.abs(path.x - path.estimates["x_hat"])[late]
    assert residuals[:, 0].max() <= 0.1 * (1 + 1e-9) and residuals[:, 1].max() <= 0.2 * (1 + 1e-9)


@pytest.mark.parametrize("every", [None, "0.05"])
def test_noise_is_compared_and_sent(every):
    about = replace(turning(law("0.1", every=every)), noise=box([-0.04], [0.04]))
    run = simulate(system(about, [["1"], ["0.4"]]), plan("40", [1, 0.5], [0, 0], seed=2), about.sampling)
    path = run.trajectories[0]
    at = np.searchsorted(path.t, path.t_k)
    noise = path.y_k[:, 0] - path.x[at, 0]
    assert 0.03 < np.abs(noise).max() <= 0.04 and len(set(np.round(noise, 12))) == len(noise) > 5
    differences = np.abs(path.y_k[:, 0] - path.estimates["x_hat"][at, 0])
    assert differences.min() >= 0.1 * (1 - 1e-9)
    if every is None:
        assert differences[path.t_k > 0] == pytest.approx(0.1, rel=1e-9)
        late = path.t > 0
        assert np.abs(path.x - path.estimates["x_hat"])[late, 0].max() <= 0.14 * (1 + 1e-9)
    else:
        assert path.t_k / 0.05 == pytest.approx(np.round(path.t_k / 0.05), abs=1e-9)


@pytest.mark.parametrize("every", [None, "0.05"])
def test_a_run_is_the_same_alone(every):
    about = replace(turning(law("0.1", every=every)), noise=box([-0.04], [0.04]), disturbance=box([0, -0.1], [0, 0.1]))
    loop = system(about, [["1"], ["0.4"]])
    asked = plan("10", None, [0, 0], initial_box=box([-1, -1], [1, 1]), runs=4, seed=3)
    many = simulate(loop, asked, about.sampling)
    assert len({len(path.t_k) for path in many.trajectories}) > 1
    for number, path in enumerate(many.trajectories):
        alone = simulate(loop, replace(asked, runs=1), about.sampling, first=number).trajectories[0]
        assert alone.t_k == pytest.approx(path.t_k, rel=1e-9, abs=1e-12)
        assert alone.y_k == pytest.approx(path.y_k, rel=1e-6, abs=1e-9)


def test_stiff_runs_send_at_the_same_instants():
    about = plant(("x", "z"), [["0.5", "0"], ["0", "-2e5"]], law=law("0.25"))
    run = simulate(system(about, [["0.5"], ["0"]]), plan("8", [1, 1], [0, 0]), about.sampling)
    assert run.implicit == 1 and run.trajectories[0].t_k[1] == pytest.approx(2 * np.log(2), rel=1e-7)


def test_a_run_without_messages_is_archived():
    about = growing(law("100"))
    run = simulate(system(about, [["1"]]), plan("2", None, [0], initial_box=box([1], [1]), runs=2), about.sampling)
    assert [one.measurements for one in run.summaries] == [0, 0] and run.summaries[0].period_min is None
    again = from_bytes(to_bytes(run), run.document())
    assert [len(path.t_k) for path in again.trajectories] == [0, 0]


def test_gains_that_leave_the_difference_end_the_run():
    about = growing(law("0.25"))
    run = simulate(system(about, [["0"]]), plan("8", [1], [0]), about.sampling)
    assert "accumulate" in (run.summaries[0].stopped or "") and run.summaries[0].measurements == 1


def test_typed_instants_are_refused():
    about = growing(law("0.25"))
    with pytest.raises(SpecError, match="send when their outputs have changed"):
        simulate(system(about, [["1"]]), plan("8", [1], [0], sampling_times="0.1"), about.sampling)
