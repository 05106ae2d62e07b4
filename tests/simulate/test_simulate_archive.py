"""simulation.npz: what goes in comes out, and the same run gives the same bytes."""

import io
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from loops import box, copy_observer, pendulum, periodic, plan, read

from cdobs_cli.errors import ArtefactError
from cdobs_cli.simulate.agreement import agrees
from cdobs_cli.simulate.archive import arrays, from_bytes, to_bytes
from cdobs_cli.simulate.engine import simulate


def many():
    stops = ((read("0.9 - theta**2", ["theta"]), "theta grew"),)
    system = copy_observer(pendulum().plant, ["1", "1.8361"], stops=stops)
    return simulate(system, plan("3", None, [0, 0], initial_box=box([-1, -1], [1, 1]), runs=3), periodic("0.6"))


def test_the_run_comes_back():
    run = many()
    back = from_bytes(to_bytes(run), run.document())
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


def test_how_many_runs_were_implicit_comes_back_and_is_no_more_than_there_are():
    run = replace(many(), implicit=2)
    assert from_bytes(to_bytes(run), run.document()).implicit == 2
    with pytest.raises(ArtefactError, match="more implicit runs"):
        from_bytes(to_bytes(run), replace(run, implicit=4).document())


def test_the_same_run_gives_the_same_bytes():
    assert to_bytes(many()) == to_bytes(many())


def archive(content, **changed):
    stream = io.BytesIO()
    np.savez_compressed(stream, **(content | changed))
    return stream.getvalue()


def with_header(text):
    """An archive whose array t promises what the header text says."""
    stream, header = io.BytesIO(), text.encode().ljust(117) + b"\n"
    with zipfile.ZipFile(stream, "w") as pack:
        pack.writestr("t.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(64))
    return stream.getvalue()


def damaged(run):
    whole, content = to_bytes(run), arrays(run)
    bad_deflate = bytearray(whole)
    bad_deflate[200:260] = bytes(60)
    yield "cut", whole[:-100]
    yield "empty", b""
    yield "deflate", bytes(bad_deflate)
    yield (
        "header of 1e15 entries",
        with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }"),
    )
    yield "header of objects", with_header("{'descr': '|O', 'fortran_order': False, 'shape': (8,), }")
    yield "header of a negative shape", with_header("{'descr': '<f8', 'fortran_order': False, 'shape': (-8,), }")
    yield "no header", with_header("(")
    yield "a missing array", archive({name: value for name, value in content.items() if name != "x"})
    yield "unequal lengths", archive(content, x=content["x"][:-1])
    yield "an estimate of one column", archive(content, x_hat=content["x_hat"][:, :1])
    yield "single precision", archive(content, t=content["t"].astype(np.float32))
    yield "pickled objects", archive(content, t=np.array([None] * len(content["t"]), dtype=object))
    yield "offsets that overlap", archive(content, offsets=content["offsets"][::-1])
    yield "offsets in halves", archive(content, offsets=content["offsets"] / 1.0)
    yield "times that are not numbers", archive(content, t=content["t"] * np.nan)
    yield "one run fewer", archive(content, stopped=content["stopped"][:-1])


@pytest.fixture(scope="module")
def stored():
    return many()


@pytest.mark.parametrize("number", range(16))
def test_damage_is_an_artefact_error(stored, number):
    _, content = list(damaged(stored))[number]
    with pytest.raises(ArtefactError, match="simulate again"):
        from_bytes(content, stored.document())


def test_the_figures_of_another_run_are_an_artefact_error(stored):
    run = stored
    one = simulate(pendulum(), plan("1", [1, 0], [0, 0]), periodic("0.6"))
    with pytest.raises(ArtefactError, match="numbers of runs differ"):
        from_bytes(to_bytes(run), one.document())


def test_a_summary_of_wrong_types_is_an_artefact_error():
    run = many()
    for change in ({"diverged": 0}, {"measurements": True}, {"rmse": []}, {"stopped": 3}, {"extra": 1}):
        document = run.document()
        with pytest.raises(ArtefactError, match="simulate again"):
            from_bytes(to_bytes(run), document | {"overall": document["overall"] | change})


def test_figures_that_the_trajectories_do_not_show_are_seen():
    system = pendulum()
    run = simulate(system, plan("2", [1, 0], [0, 0]), periodic("0.6"))
    assert agrees(run, system)
    for change in (
        {"measurements": 3},
        {"error_final": 0.0},
        {"rmse": {}},
        {"period_max": 0.5},
        {"diverged": True},
        {"stopped": "early"},
    ):
        better = replace(run.overall, **change)
        assert not agrees(replace(run, summaries=(better,), overall=better), system)
    other = replace(run, overall=replace(run.overall, left_domain=True))
    assert not agrees(other, system)
    apart = copy_observer(system.plant, ["30", "30"])
    lost = simulate(apart, plan("12", [1, 0], [0, 0]), periodic("0.6"))
    assert lost.overall.diverged
    assert agrees(lost, apart)
    kept = replace(lost.overall, diverged=False)
    assert not agrees(replace(lost, summaries=(kept,), overall=kept), apart)
