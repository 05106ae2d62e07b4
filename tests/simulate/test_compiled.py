"""Machine code against the array path: every kind of loop, every function of the language, and what may be loaded."""

from __future__ import annotations

import ctypes
import os
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from loops import box, copy_observer, pendulum, periodic, plan, plant, read

from cdobs_cli import library
from cdobs_cli.codegen import c_function, prelude
from cdobs_cli.exact.compiled import compile_floats
from cdobs_cli.exact.expression import Expression, Power, Variable, call, power
from cdobs_cli.exact.language import LANGUAGE
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.hybrid import HybridSystem
from cdobs_cli.plant import Domain, Input, Interval
from cdobs_cli.sampling import SamplingLaw
from cdobs_cli.sensors import Sensor
from cdobs_cli.simulate.compiled import Compiled
from cdobs_cli.simulate.engine import simulate_batch
from cdobs_cli.simulate.loop import ClosedLoop
from cdobs_cli.simulate.signals import Signals

pytestmark = pytest.mark.skipif(library.compiler() is None, reason="no compiler")
APERIODIC = SamplingLaw("aperiodic", Exact("0"), Exact("0.7"))


def triggered(text="elapsed - 0.3 - 0.1*sin(hat__theta)", **further) -> HybridSystem:
    system = pendulum(**further)
    trigger = read(text, ["elapsed", *system.states])
    return replace(system, observer=replace(system.observer, trigger=trigger))


def stopped() -> HybridSystem:
    system = pendulum(["1", "0.1"])
    stops = ((read("0.9 - omega**2", ["omega"]), "too fast"),)
    return replace(system, observer=replace(system.observer, stops=stops))


def bounds() -> HybridSystem:
    """A copy with a known distance to either side, which the state leaves."""
    system = pendulum()
    hat = system.observer.estimates["x_hat"]
    half = Exact("0.4").expression
    ends = {"x_lower": tuple(one - half for one in hat), "x_upper": tuple(one + half for one in hat)}
    return replace(system, observer=replace(system.observer, estimates=ends))


def fed() -> HybridSystem:
    model = plant(
        ("theta", "omega"), [[0, 1], [0, 0]], ("0", "sin(theta)"), B=[[0], [1]],
        inputs=[Input("F", Interval(Exact(-9), Exact(9)))], law=periodic("0.3"), noise=box([-0.01], [0.01]),
    )  # fmt: skip
    return copy_observer(model, ["1", "1.8"])


PATTERN = SamplingLaw.multirate(Exact("0.2"), [Sensor("gyro", (0,), Fraction(1)), Sensor("camera", (1,), Fraction(3))])


def in_turn() -> HybridSystem:
    """theta at every sample, omega at every third, each kind of sample with a jump of its own."""
    model = plant(
        ("theta", "omega"), [[0, 1], [0, 0]], ("0", "sin(theta)"), [[1, 0], [0, 1]], law=PATTERN,
        noise=box([-0.05, -0.05], [0.05, 0.05]),
    )  # fmt: skip
    names = ["hat.theta", "hat.omega", "y.0", "y.1"]
    jumps = [("y__0", "0.5*hat__omega + 0.5*y__1"), *[("y__0", "hat__omega + y__0 - hat__theta")] * 2]
    system = copy_observer(model, ["0", "0"])
    rows = tuple(tuple(read(row, names) for row in jump) for jump in jumps)
    return replace(system, observer=replace(system.observer, jump=rows[0], jumps=rows))


def in_a_domain() -> HybridSystem:
    return pendulum(domain=Domain({"theta": Interval(Exact("-1.5"), Exact("1.5"))}))


COVARIANCE = ExactMatrix([["0.0004"]])
INTENSITY = ExactMatrix([["0.02", "0.01"], ["0.01", "0.03"]])
LOOPS = {
    "quiet": (pendulum(), None, {}),
    "aperiodic": (pendulum(), APERIODIC, {}),
    "lossy": (pendulum(), SamplingLaw.periodic(Exact("0.2"), 2), {}),
    "random": (pendulum(), SamplingLaw.randomly(Exact("0.2"), Exact("0.3")), {}),
    "boxes": (pendulum(noise=box([-0.1], [0.2]), disturbance=box([0, -1], [0.5, 1])), APERIODIC, {}),
    "white": (pendulum(covariance=COVARIANCE, intensity=INTENSITY), APERIODIC, {}),
    "typed": (pendulum(noise=box([-1], [1])), None, {"signals": {"v.0": "0.1*sin(5*t)"}}),
    "triggered": (triggered(noise=box([-0.1], [0.1])), SamplingLaw("updated"), {}),
    "triggered white": (triggered(intensity=INTENSITY), SamplingLaw("updated"), {}),
    "often": (triggered("elapsed - 0.01"), SamplingLaw("updated"), {}),
    "unready": (triggered("elapsed + hat__theta - 0.3"), SamplingLaw("updated"), {}),
    "in turn": (in_turn(), PATTERN, {}),
    "stopped": (stopped(), None, {}),
    "bounds": (bounds(), None, {}),
    "domain": (in_a_domain(), APERIODIC, {}),
    "diverging": (pendulum(["1", "-40"]), None, {}),
    "escaping": (copy_observer(plant(("x",), [[0]], ["x**2"], law=periodic("0.5")), ["0.5"]), None, {}),
    "singular": (copy_observer(plant(("x",), [[-1]], ["-sqrt(x)"], law=periodic("0.5")), ["0.5"]), None, {}),
}


def compiled_of(system, asked) -> Compiled:
    made = Compiled.of(ClosedLoop(system, Signals.of(system.plant, asked.signals, system.observer.control)))
    assert made is not None
    return made


def asked_of(system, runs=12, horizon="8", **further):
    n = system.plant.n
    return plan(horizon, None, [0] * n, initial_box=box([-1] * n, [1] * n), runs=runs, seed=3, **further)


@pytest.mark.parametrize("name", LOOPS)
def test_every_kind_of_loop_runs_as_over_arrays(name):
    system, law, further = LOOPS[name]
    asked = asked_of(system, **further)
    law = law or system.plant.sampling
    arrays, code = (simulate_batch(system, asked, law, compiled=one) for one in (None, compiled_of(system, asked)))
    assert [one.stopped for one in code.summaries] == [one.stopped for one in arrays.summaries]
    assert np.array_equal(code.samples.offsets, arrays.samples.offsets)
    assert np.allclose(code.samples.t, arrays.samples.t, rtol=1e-10, atol=1e-12)
    assert np.array_equal(code.paths.offsets, arrays.paths.offsets)
    ended = {run for run, one in enumerate(code.summaries) if one.stopped is not None}
    tame = ~np.isin(code.paths.run, list(ended)) if name in ("diverging", "escaping") else slice(None)
    assert np.allclose(code.paths.z[:, tame], arrays.paths.z[:, tame], rtol=1e-7, atol=1e-8)
    for one, other in zip(code.summaries, arrays.summaries, strict=True):
        assert (one.diverged, one.left_domain, one.measurements) == (
            other.diverged, other.left_domain, other.measurements,
        )  # fmt: skip
        assert (one.departure is None) == (other.departure is None)
        if one.departure is not None and other.departure is not None:
            assert one.departure.what == other.departure.what
            # It is seen at the first step or point of the grid beyond, and steps differ in their last digits.
            assert one.departure.time == pytest.approx(other.departure.time, abs=code.grid[1])
            assert one.departure.beyond == pytest.approx(other.departure.beyond, rel=1e-6)
        if other.inclusion_margin is not None:
            assert one.inclusion_margin == pytest.approx(other.inclusion_margin, rel=1e-6, abs=1e-9)


def test_the_kinds_of_loops_do_what_they_are_for():
    """So that the comparison above is of something."""
    told = {}
    for name in ("stopped", "diverging", "escaping", "domain", "bounds", "unready", "often", "singular"):
        system, law, further = LOOPS[name]
        told[name] = simulate_batch(system, asked_of(system, **further), law or system.plant.sampling).summaries
    assert any("too fast" in (one.stopped or "") for one in told["stopped"])
    assert any(one.diverged for one in told["diverging"])
    assert any(one.diverged for one in told["escaping"])
    assert any("undefined or singular" in (one.stopped or "") for one in told["singular"])
    assert any(one.left_domain for one in told["domain"])
    assert any((one.inclusion_margin or 0) < 0 for one in told["bounds"])
    assert any("not below 0" in (one.stopped or "") for one in told["unready"])
    assert min(one.measurements for one in told["often"]) > 700


def test_an_input_may_be_fed_back_and_leave_its_range():
    system = fed()
    hat = {name: Variable(f"hat.{name}") for name in system.plant.states}
    law = -Exact("20").expression * hat["theta"] - Exact("3").expression * hat["omega"] - Variable("y.0")
    asked = asked_of(system, signals={"F": law})
    arrays, code = (
        simulate_batch(system, asked, system.plant.sampling, compiled=one) for one in (None, compiled_of(system, asked))
    )
    assert any("left its declared range" in (one.stopped or "") for one in arrays.summaries)
    assert [one.stopped for one in code.summaries] == [one.stopped for one in arrays.summaries]
    assert np.allclose(code.paths.z, arrays.paths.z, atol=1e-8)


def test_a_signal_outside_its_interval_is_told_by_the_array_path():
    from cdobs_cli.errors import SpecError

    system = fed()
    asked = asked_of(system, signals={"F": "20*sin(t)"})
    with pytest.raises(SpecError, match="leaves its declared interval"):
        simulate_batch(system, asked, system.plant.sampling, compiled=compiled_of(system, asked))


def values(expression: Expression, x: np.ndarray) -> np.ndarray:
    """By C, at rows of a and b."""
    code = c_function("f", "const double *y", [expression], {"a": "y[0]", "b": "y[1]"})
    source = prelude(code) + code
    source += "void at(const double *y, double *out) { f(y, out); }\n"
    loaded = library.library(source)
    assert loaded is not None
    out, made = np.empty(1), []
    for row in np.ascontiguousarray(x.T):
        loaded[0].at(ctypes.c_void_p(row.ctypes.data), ctypes.c_void_p(out.ctypes.data))
        made.append(out[0])
    return np.array(made)


def _expressions() -> dict[str, Expression]:
    a, b = Variable("a"), Variable("b")
    further = {2: (a, b), 1: (a,), 3: (a, -abs_of(b), abs_of(b))}
    every = {name: call(name, *further[one.arity]) for name, one in LANGUAGE.items()}
    every |= {f"power {e}": power(a, Fraction(e)) for e in ("2", "-1", "3", "-4", "7", "-9", "1/2", "-5/3")}
    return every


def abs_of(x: Expression) -> Expression:
    return call("abs", x)


@pytest.mark.parametrize("name", _expressions())
def test_every_function_of_the_language_is_what_it_is_over_arrays(name):
    expression = _expressions()[name]
    x = np.random.default_rng(0).uniform(-3, 3, (2, 200))
    x[:, :6] = [[0, 0.5, -0.5, 1, np.inf, np.nan], [0, -0.5, 0.5, np.nan, 1, 0]]
    with np.errstate(all="ignore"):
        (wanted,) = compile_floats([expression], ["a", "b"], arrays=True)(*x)
        assert np.allclose(values(expression, x), np.broadcast_to(wanted, 200), rtol=1e-14, equal_nan=True)


def test_powers_are_read_as_written():
    assert isinstance(power(Variable("a"), Fraction(-4)), Power)
    text = c_function("f", "const double *y", [power(Variable("a"), Fraction(-4))], {"a": "y[0]"})
    assert "1.0 / (y[0] * y[0] * y[0] * y[0])" in text


def test_without_a_compiler_there_is_no_machine_code(monkeypatch):
    library.compiler.cache_clear()
    monkeypatch.setenv(library.VARIABLE, "")
    try:
        assert library.compiler() is None
        assert library.library("int x;") is None
    finally:
        monkeypatch.undo()
        library.compiler.cache_clear()


def test_what_another_could_have_written_is_not_loaded(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    source = "int answer(void) { return 42; }\n"
    made = library.library(source)
    assert made is not None
    loaded, path = made
    assert loaded.answer() == 42
    path.unlink()  # the loaded one stays whole
    path.write_bytes(b"no library")
    path.chmod(0o777)
    again = library.library(source)  # made anew, as others may have written it
    assert again is not None
    assert again[1].stat().st_mode & 0o022 == 0
    os.chmod(tmp_path / "cdobs", 0o777)
    assert library.library(source) is None


def test_what_is_no_c_is_no_library():
    assert library.library("this is not C") is None
