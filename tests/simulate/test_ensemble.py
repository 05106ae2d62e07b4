"""Many runs: the same bits for any batch, percentiles, the worst run, and what a killed simulation leaves."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
from loops import box, copy_observer, pendulum, plan, plant

from cdobs_cli.errors import ArtefactError
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.run import Run
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.simulate import ensemble as module
from cdobs_cli.simulate.archive import from_bytes, to_bytes
from cdobs_cli.simulate.engine import simulate, simulate_batch
from cdobs_cli.simulate.ensemble import LEVELS, Parts, ensemble, worst_of

KEY = {"key": "k", "design": "d"}
APERIODIC = SamplingLaw("aperiodic", Exact("0.2"), Exact("0.7"))


def noisy(**further):
    return pendulum(noise=box([-0.02], [0.02]), disturbance=box([0, -0.1], [0, 0.1]), **further)


def many(runs=70, horizon="6", **further):
    return plan(horizon, None, [0, 0], initial_box=box([-1, -1], [1, 1]), runs=runs, seed=5, **further)


def made(folder, system=None, asked=None, law=APERIODIC, batch=500, **further):
    return ensemble(
        system or noisy(), asked or many(), law, Parts(folder / "parts", KEY, **further), runs_of_a_batch=batch
    )


def bits(run: Run) -> bytes:
    return to_bytes(run) + json.dumps(run.document(), sort_keys=True).encode()


@pytest.fixture(params=["compiled", "arrays"])
def path(request, monkeypatch):
    if request.param == "arrays":
        monkeypatch.setattr(module, "_compiled", lambda *loop: None)
    else:
        monkeypatch.setattr(module, "COMPILED_FROM", 0)
    return request.param


@pytest.mark.parametrize(("batch", "workers"), [(2, 1), (23, 2), (69, 1), (70, 3)])
def test_any_batch_and_any_number_of_workers_give_the_same_bits(tmp_path, path, batch, workers):
    whole = bits(made(tmp_path))
    assert bits(made(tmp_path, batch=batch, workers=workers)) == whole
    assert not (tmp_path / "parts").exists()


def test_nine_states_are_summed_in_one_order(tmp_path, path):
    """A sum over one column of many rows is taken in another order than over many columns."""
    n = 9
    A = [[int(j == i + 1) for j in range(n)] for i in range(n)]
    A[n - 1] = [-(k + 1) for k in range(n)]
    system = copy_observer(plant([f"x{i}" for i in range(n)], A), [str(1 / (i + 1)) for i in range(n)])
    asked = plan("3", None, [0] * n, initial_box=box([-1] * n, [1] * n), runs=35, seed=1)
    one, other = (made(tmp_path, system, asked, batch=batch) for batch in (34, 5))
    assert bits(one) == bits(other)


def test_runs_that_escape_leave_the_others_as_they_are(tmp_path, path):
    """x' = x^2 from [-1, 1]: some states are unbounded before the horizon, and end beside others that go on."""
    system = copy_observer(plant(("x",), [[0]], ["x**2"]), ["0.5"])
    asked = plan("3", None, [0], initial_box=box([-1], [1]), runs=37, seed=2)
    whole = made(tmp_path, system, asked, system.plant.sampling)
    stopped = [one.stopped is not None for one in whole.summaries]
    assert 0 < sum(stopped) < 37
    for batch in (2, 9):
        assert bits(made(tmp_path, system, asked, system.plant.sampling, batch=batch)) == bits(whole)
    start = np.array([one.x[0, 0] for one in whole.trajectories])
    end = np.array([one.x[-1, 0] for one in whole.trajectories])
    goes_on = start < 0
    assert goes_on.any()
    assert end[goes_on] == pytest.approx(start[goes_on] / (1 - 3 * start[goes_on]), rel=1e-10)


def test_what_is_shown_of_a_run_is_that_run(tmp_path, path):
    run = made(tmp_path)
    assert run.ensemble is not None
    alone = simulate_batch(noisy(), many(), APERIODIC)
    assert len(run.summaries) == 70
    assert run.shown[:20] == tuple(range(20))
    assert run.ensemble.worst in run.shown
    for number, trajectory in zip(run.shown, run.trajectories, strict=True):
        shown = alone.trajectory(number)
        assert np.array_equal(trajectory.t_k, shown.t_k)
        assert np.allclose(trajectory.x, shown.x, atol=1e-8)
        assert run.summaries[number].error_max["omega"] == pytest.approx(alone.summaries[number].error_max["omega"])


def test_percentiles_are_those_of_all_errors(tmp_path):
    run, system = made(tmp_path), noisy()
    assert run.bands is not None
    every = simulate(system, many(), APERIODIC)  # the same runs, on the same grid
    t = run.bands.t
    for j, name in enumerate(("theta", "omega")):
        errors = []
        for one in every.trajectories:
            last = np.searchsorted(one.t, t + 1e-9, side="right") - 1
            errors.append(np.abs(one.estimates["x_hat"][last, j] - one.x[last, j]))
        inside = [np.max(np.diff(one.t)) for one in every.trajectories]
        assert max(inside) <= 1.001 * t[1]
        wanted = np.percentile(np.array(errors), LEVELS, axis=0, method="lower")
        # Next to a jump the grid point is the jump's: a step's width may lie between.
        far = np.mean(np.abs(run.bands.values[name] - wanted) > 1e-6)
        assert far < 0.02
        assert np.all(np.diff(run.bands.values[name], axis=0) >= 0)


def test_of_a_few_runs_all_are_shown(tmp_path):
    run = made(tmp_path, asked=many(32))
    assert run.ensemble is None
    assert len(run.trajectories) == 32


def test_the_worst_run_is_the_first_that_ends_early_or_errs_most(tmp_path):
    run = made(tmp_path)
    late = np.array([list(one.rmse_after_transient.values()) for one in run.summaries])
    assert worst_of(run.summaries) == int(np.argmax((late / np.median(late, axis=0)).max(axis=1)))
    stopped = list(run.summaries)
    stopped[33] = replace(stopped[33], stopped="the error grew")
    assert worst_of(stopped) == 33


def test_what_is_shown_is_kept_when_it_is_made(tmp_path, monkeypatch):
    asked = []
    batch = module._Ensemble.batch
    monkeypatch.setattr(
        module._Ensemble, "batch", lambda self, first, count: asked.append(first) or batch(self, first, count)
    )
    made(tmp_path, batch=16)
    assert sorted(asked) == [0, 16, 32, 48, 64]


@pytest.mark.parametrize("seed", range(8))
def test_the_worst_run_is_among_those_kept_of_its_batch(tmp_path, seed):
    sizes = np.random.default_rng(seed).integers(1, 4, (70, 3)).astype(float)  # many are alike
    every = [
        replace(
            one, stopped="it grew" if seed > 5 and row[2] > 2 else None, rmse={"theta": row[2], "omega": 0.5},
            rmse_after_transient=dict(zip(("theta", "omega"), row * (seed not in (2, 3)), strict=False)),
        )
        for one, row in zip(made(tmp_path).summaries, sizes, strict=True)
    ]  # fmt: skip
    kept = set()
    for first in range(0, 70, 14):
        kept |= module._may_be_worst(dict(enumerate(every[first : first + 14], first)))
    assert worst_of(every) in kept
    assert worst_of(every) in module._may_be_worst({number: every[number] for number in sorted(kept)})


def test_runs_that_diverge_are_counted_and_their_percentiles_are_infinite(tmp_path, path):
    system = pendulum(["1", "-40"])
    run = made(tmp_path, system, many(40, "30"), system.plant.sampling)
    assert run.ensemble is not None
    assert run.bands is not None
    assert run.ensemble.diverged > 0.5
    assert run.summaries[run.ensemble.worst].diverged
    assert run.bands.values["omega"][-1, -1] == np.inf
    again = from_bytes(to_bytes(run), {**run.document(), "digests": {}})
    assert again.ensemble == run.ensemble


class KilledError(Exception):
    pass


@pytest.mark.parametrize("damage", [None, "errors", "document", "key"])
def test_a_killed_simulation_goes_on_where_it_was(tmp_path, monkeypatch, damage):
    whole = bits(made(tmp_path, batch=10))
    done = []

    def doing(words):
        done.append(words)
        if len(done) == 4:
            raise KilledError

    monkeypatch.setattr(module.progress, "doing", doing)
    with pytest.raises(KilledError):
        made(tmp_path, batch=10)
    parts = tmp_path / "parts"
    left = sorted(path.name for path in parts.glob("*.json"))
    assert len(left) >= 4
    if damage == "errors":
        np.save(parts / "000010.npy", np.zeros((3, 2, 5)))
    elif damage == "document":
        document = json.loads((parts / "000010.json").read_text())
        document["summaries"][0]["measurements"] += 1
        (parts / "000010.json").write_text(json.dumps(document))
    monkeypatch.undo()
    asked = []
    batch = module._Ensemble.batch
    monkeypatch.setattr(
        module._Ensemble, "batch", lambda self, first, count: asked.append(first) or batch(self, first, count)
    )
    key = {"key": "other", "design": "d"} if damage == "key" else KEY
    again = ensemble(noisy(), many(), APERIODIC, Parts(parts, key, resumes=True), runs_of_a_batch=10)
    assert bits(again) == whole
    redone = set(asked[:-2]) & {int(name.removesuffix(".json")) for name in left}
    assert redone == {None: set(), "key": {int(name[:6]) for name in left}}.get(damage, {10})


def test_without_resume_what_is_left_is_not_used(tmp_path):
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "000000.json").write_text("{}")
    assert bits(made(tmp_path)) == bits(made(tmp_path))


@pytest.mark.parametrize("change", ["worst", "diverged", "shown", "falls", "shape"])
def test_an_edited_ensemble_is_refused(tmp_path, change):
    run = made(tmp_path)
    assert run.ensemble is not None
    assert run.bands is not None
    document, content = {**run.document(), "digests": {}}, to_bytes(run)
    from_bytes(content, document)
    if change == "falls":
        values = {name: rows[::-1] for name, rows in run.bands.values.items()}
        content = to_bytes(replace(run, bands=replace(run.bands, values=values)))
    elif change == "shape":
        values = {name: rows[:, 1:] for name, rows in run.bands.values.items()}
        content = to_bytes(replace(run, bands=replace(run.bands, values=values)))
    else:
        edited = {"worst": "w", "diverged": 0.5, "shown": [0, 1]}[change]
        document["ensemble"] = {**document["ensemble"], change: edited}
    with pytest.raises(ArtefactError):
        from_bytes(content, document)


def test_the_command_goes_on_and_shows_percentiles(cdobs, tmp_path, pendulum):
    text = pendulum.split("simulation:")[0] + (
        "simulation:\n  horizon: 5\n  initial_box: {lower: [-1, -1], upper: [1, 1]}\n"
        "  initial_estimate: [0, 0]\n  runs: 50\n"
    )
    (tmp_path / "p.yaml").write_text(text)
    assert cdobs("simulate", "p.yaml", "--resume").returncode == 0
    document = json.loads((tmp_path / "results/p/simulation.json").read_text())
    assert document["ensemble"]["runs"] == len(document["runs"]) == 50
    assert (tmp_path / "results/p/figures/bands.svg").exists()
    assert not (tmp_path / "results/p/simulation.parts").exists()
    assert cdobs("simulate", "p.yaml").returncode == 0
