"""simulation.npz: what goes in comes out, and the same run gives the same bytes."""

import numpy as np
import pytest
from loops import box, copy_observer, pendulum, periodic, plan, read

from cdobs_cli.errors import ArtefactError
from cdobs_cli.simulate.archive import arrays, from_arrays, from_file, to_bytes
from cdobs_cli.simulate.engine import simulate


def many():
    stops = ((read("0.9 - theta**2", ["theta"]), "theta grew"),)
    system = copy_observer(pendulum().plant, ["1", "1.8361"], stops=stops)
    return simulate(system, plan("3", None, [0, 0], initial_box=box([-1, -1], [1, 1]), runs=3), periodic("0.6"))


def test_the_run_comes_back(tmp_path):
    run = many()
    (tmp_path / "simulation.npz").write_bytes(to_bytes(run))
    back = from_file(tmp_path / "simulation.npz", run.document())
    assert back.document() == run.document()
    assert len(back.trajectories) == 3
    assert any(trajectory.stopped for trajectory in back.trajectories)
    for before, after in zip(run.trajectories, back.trajectories, strict=True):
        assert np.array_equal(before.t, after.t)
        assert np.array_equal(before.x, after.x)
        assert np.array_equal(before.estimates["x_hat"], after.estimates["x_hat"])
        assert np.array_equal(before.t_k, after.t_k)
        assert np.array_equal(before.y_k, after.y_k)
        assert before.stopped == after.stopped


def test_the_same_run_gives_the_same_bytes():
    assert to_bytes(many()) == to_bytes(many())


def test_damage_is_an_artefact_error(tmp_path):
    run = many()
    path = tmp_path / "simulation.npz"
    path.write_bytes(to_bytes(run)[:-100])
    with pytest.raises(ArtefactError, match="simulate again"):
        from_file(path, run.document())
    with pytest.raises(ArtefactError):
        from_file(tmp_path / "missing.npz", run.document())
    one = simulate(pendulum(), plan("1", [1, 0], [0, 0]), periodic("0.6"))
    with pytest.raises(ArtefactError, match="numbers of runs differ"):
        from_arrays(arrays(run), one.document())
