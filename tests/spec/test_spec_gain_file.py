"""Gains of other tools: MATLAB files as scipy writes them, damaged ones, arrays and systems of python-control."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command import PENDULUM
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.io import savemat
from scipy.linalg import expm

from cdobs_cli import api
from cdobs_cli.errors import SpecError, UsageError
from cdobs_cli.spec.matlab import MatlabError, real_matrices
from cdobs_cli.spec.model import load

Write = Callable[..., Path]
FILE = PENDULUM.replace("  method: set\n", "  gain: {file: design.mat}\n")
TYPED = PENDULUM.replace("  method: set\n", "  gain: {K: [[1], [1.3]]}\n")
LINEAR = TYPED.replace("sin(theta)", "0").replace("[[0, 0], [1, 0]]", "[[0, 0], [0, 0]]")
K = np.array([[1.0], [1.3]])


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """A spec beside a file with variables."""

    def written(text: str = FILE, /, **variables: Any) -> Path:
        savemat(tmp_path / "design.mat", variables, do_compression=True)
        (tmp_path / "p.yaml").write_text(text)
        return tmp_path / "p.yaml"

    return written


@pytest.mark.parametrize("kind", ["f8", "f4", "i1", "u2", "i4", "u8"])
@pytest.mark.parametrize("compressed", [True, False])
def test_matrices_are_read_as_scipy_wrote_them(tmp_path: Path, kind: str, compressed: bool) -> None:
    M = np.arange(6).reshape(3, 2).astype(kind)
    others = {"text": "words", "cell": np.array([1, "a"], object), "struct": {"a": 1}, "z": np.eye(2) * 1j, "b": M > 2}
    savemat(tmp_path / "m.mat", {**others, "M": M, "s": 0.1, "wide": np.zeros((80, 80))}, do_compression=compressed)
    found = real_matrices((tmp_path / "m.mat").read_bytes())
    assert set(found) == {"M", "s"}
    assert np.array_equal(found["M"], M) and found["s"] == ((0.1,),)


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_damaged_files_are_refused_or_read(tmp_path_factory: pytest.TempPathFactory, data: st.DataObject) -> None:
    path = tmp_path_factory.getbasetemp() / "fuzzed.mat"
    if not path.exists():
        savemat(path, {"K": K, "c": {"a": 1}}, do_compression=False)
    content = bytearray(path.read_bytes())
    for _ in range(data.draw(st.integers(1, 6))):
        content[data.draw(st.integers(0, len(content) - 1))] = data.draw(st.integers(0, 255))
    try:
        found = real_matrices(bytes(content[: data.draw(st.integers(0, len(content)))]))
    except MatlabError:
        return
    assert all(len(row) == len(rows[0]) for rows in found.values() for row in rows)


def test_a_file_that_would_grow_is_cut(tmp_path: Path) -> None:
    savemat(tmp_path / "m.mat", {"K": np.zeros((2000, 2000))}, do_compression=True)
    with pytest.raises(MatlabError, match="damaged"):
        real_matrices((tmp_path / "m.mat").read_bytes())


def test_the_gain_is_that_of_the_file(write: Write, tmp_path: Path) -> None:
    spec = load(write(K=K))
    (tmp_path / "t.yaml").write_text(TYPED.replace("[[1], [1.3]]", "[[1.0], [1.3]]"))
    assert spec.normalised() == load(tmp_path / "t.yaml").normalised()
    other = FILE.replace("{file: design.mat}", "{file: design.mat, variables: {K: Kalman}}")
    assert load(write(other, Kalman=K, K=-K)).normalised() == spec.normalised()


def test_numbers_of_updated_sampling(write: Write) -> None:
    text = """
spec_version: 1
plant: {states: [x1, x2], A: [[0, 1], [0, 0]], phi: ["0", "sin(x1)"], lipschitz: [[0, 0], [1, 0]]}
measurement: {C: [[1, 0]], sampling: {updated: true}}
observer: {family: updated_sampling, gain: {file: design.mat}}
"""
    numbers = {"alpha": 0.9, "a1": 0.33, "a2": 4.1, "a3": 0}
    given_gain = load(write(text, K=-K, **numbers)).normalised()["observer"]["gain"]
    assert {name: float(value) for name, value in given_gain.items() if name != "K"} == numbers
    with pytest.raises(SpecError, match="alpha a number"):
        load(write(text, **{**numbers, "alpha": K}))


@pytest.mark.parametrize(
    ("typed", "told"),
    [
        ("{file: design.mat, K: [[1], [1]]}", "observer.gain.K: unknown key; allowed: file, variables"),
        ("{file: other.mat}", "the file cannot be read: No such file"),
        ("{file: /etc/design.mat}", "stands below the folder of its spec"),
        ("{file: ../design.mat}", "stands below the folder of its spec"),
        ("{file: design.csv}", "a name that ends with .mat"),
        ("{file: 3}", "a file name is expected"),
        ("{file: design.mat, variables: {K: wrong}}", "observer.gain.variables.K: the file has no such real matrix"),
        ("{file: design.mat, variables: {L: K}}", "unknown name; allowed: K"),
        ("{file: design.mat, variables: [K]}", "names of variables are expected"),
        ("{file: folder.mat}", "a directory"),
        ("{file: text.mat}", "this is no MATLAB file"),
        ("{file: new.mat}", "save it with '-v7'"),
        ("{file: design.mat, variables: {K: huge}}", "no finite numbers"),
        ("{file: design.mat, variables: {K: none}}", "no such real matrix"),
    ],
)
def test_mistakes(write: Write, tmp_path: Path, typed: str, told: str) -> None:
    path = write(FILE.replace("{file: design.mat}", typed), K=K, huge=np.array([[np.inf], [1.0]]), none=1j * K)
    (tmp_path / "folder.mat").mkdir()
    (tmp_path / "text.mat").write_text("K = 1")
    (tmp_path / "new.mat").write_text("MATLAB 7.3 MAT-file".ljust(200))
    with pytest.raises(SpecError) as caught:
        load(path)
    (problem,) = caught.value.problems
    assert told in f"{problem.path}: {problem.text}" and problem.line == 13


def test_a_sweep_takes_the_matrix_along(write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write(K=K)
    monkeypatch.chdir(tmp_path)
    rows = api.sweep("p.yaml", {"measurement.sampling.period": [0.5]}, effort=0)
    assert [row["verdict"] for row in rows] == ["proved"]


# ---------------------------------------------------------------- objects


def gain_of(spec: Any) -> list[list[float]]:
    return [[float(one) for one in row] for row in spec.normalised()["observer"]["gain"]["K"]]


def test_arrays_and_what_is_none() -> None:
    spec = api.parse(PENDULUM)
    assert gain_of(api.with_gain(spec, K=K)) == K.tolist() == gain_of(api.with_gain(spec, K=[1, 1.3]))
    with pytest.raises(SpecError, match="gain"):
        api.with_gain(spec, L=K)
    with pytest.raises(SpecError, match="row"):
        api.with_gain(spec, K=np.ones((3, 1)))
    with pytest.raises(UsageError, match="K: "):
        api.with_gain(spec, K=object())
    with pytest.raises(SpecError):
        api.with_gain(spec, K=K * np.nan)


def test_observers_of_python_control() -> None:
    control = pytest.importorskip("control")
    A, C = np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[1.0, 0.0]])
    Phi, kept = expm(0.6 * A), np.eye(2) - K @ C
    spec = api.parse(LINEAR)
    current = control.StateSpace(Phi @ kept, Phi @ K, kept, K, 0.6)
    predictor = control.StateSpace(Phi @ kept, Phi @ K, np.eye(2), np.zeros((2, 1)), 0.6)
    continuous = control.StateSpace(A - K @ C, K, np.eye(2), np.zeros((2, 1)))
    unnamed = control.StateSpace(Phi @ kept, Phi @ K, np.eye(2), np.zeros((2, 1)), True)
    for system in (current, predictor, continuous, unnamed):
        assert gain_of(api.with_gain(spec, K=system)) == pytest.approx(K)
    with pytest.raises(UsageError, match=r"time step 0\.5"):
        api.with_gain(spec, K=control.StateSpace(current.A, current.B, current.C, current.D, 0.5))
    with pytest.raises(UsageError, match="1 states"):
        api.with_gain(spec, K=control.StateSpace([[0.5]], [[1]], [[1]], [[1]], 0.6))
    with pytest.raises(UsageError, match="linear plant"):
        api.with_gain(api.parse(TYPED), K=predictor)


def test_what_is_exported_to_python_control_comes_back(tmp_path: Path) -> None:
    pytest.importorskip("control")
    spec = api.parse(LINEAR, "linear")
    (written, *_) = api.export(spec, "control", out=tmp_path, effort=0)
    found = importlib.util.spec_from_file_location("exported_observer", written)
    assert found is not None and found.loader is not None
    module = importlib.util.module_from_spec(found)
    found.loader.exec_module(module)
    assert gain_of(api.with_gain(spec, K=module.system())) == pytest.approx(K)
