"""A system of python-control: built by the installed package, and equal to the simulator."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from exporting import Ready, ready

from cdobs_cli.errors import UsageError
from cdobs_cli.exact.expression import Variable
from cdobs_cli.export.control import control_text, is_linear


def loaded(one: Ready) -> dict[str, Any]:
    space: dict[str, Any] = {"__name__": "exported"}
    text = control_text(one.portable, one.about, one.vectors, one.design.sampling)
    exec(compile(text, "exported.py", "exec"), space)
    return space


@pytest.mark.parametrize(
    "case",
    [("reachability", "periodic"), ("lpv_zoh", "periodic"), ("shipped", "reachability_range_bearing")],
)
def test_its_response_is_the_simulated_one(case: tuple[str, str]) -> None:
    control = pytest.importorskip("control")
    one = ready(case)
    space = loaded(one)
    system = space["system"]()
    calls = one.vectors.calls
    corrections = [call for call in calls if call.kind == "correct"]
    # What is held from a sample on stands in the call that flows to the next one.
    flows = [call.u for call in calls if call.kind == "predict"]
    u = [*flows, flows[-1]][: len(corrections)]
    measured = np.array([[*call.y, *held] for call, held in zip(corrections, u, strict=True)]).T
    T = np.arange(len(corrections)) * space["PERIOD"]
    response = control.input_output_response(system, T, measured, space["initial"](one.vectors.start))
    expected = np.array([call.expected for call in corrections]).T
    np.testing.assert_allclose(response.outputs, expected, rtol=1e-9, atol=1e-9)
    assert system.dt == space["PERIOD"]


def test_a_linear_observer_is_a_state_space() -> None:
    control = pytest.importorskip("control")
    one = ready(("reachability", "periodic"))
    flow = (one.portable.flow[0], one.portable.flow[1].substitute({"hat.theta": Variable("hat.omega")}))
    assert not is_linear(one.portable)
    linear = replace(one.portable, flow=(flow[0], flow[0] + Variable("u")))
    assert is_linear(linear)
    space = loaded(replace(one, portable=linear))
    system = space["system"]()
    assert isinstance(system, control.StateSpace)
    x, v = (0.3, -0.2), (0.7, 0.1)
    moved = system.A @ np.array(x) + system.B @ np.array(v)
    np.testing.assert_allclose(moved, space["_update"](0.0, x, v, None), atol=1e-12)


@pytest.mark.parametrize("scheme", ["multirate", "late", "on_change"])
def test_other_schemes_say_what_to_write_instead(scheme: str) -> None:
    with pytest.raises(UsageError, match="write --to python"):
        loaded(ready(("reachability", scheme)))
