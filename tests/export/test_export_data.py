"""JSON with every decimal, and the MATLAB file."""

from __future__ import annotations

import io
import json

import numpy as np
import pytest
from exporting import Ready, ready
from scipy.io import loadmat

from cdobs_cli.certificate import Check, Claim
from cdobs_cli.design import Design
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.export.data import json_text, mat_bytes

CHECK = Check((Claim("convergence", "consequence", "proved", "It converges.", "source", required=True),))


def written(one: Ready, design: Design) -> dict[str, object]:
    text = json_text(one.portable, one.about, one.vectors, one.plant, design, CHECK)
    document: dict[str, object] = json.loads(text)
    return document


def test_no_digit_of_a_gain_is_lost() -> None:
    one = ready(("reachability", "periodic"))
    long = "0.12345678901234567890123456789"
    design = Design(one.design.family, "given", one.design.sampling, {"K": ExactMatrix([[long], ["1/3"]])})
    document = written(one, design)
    assert document["gain"] == {"K": [[long], ["1/3"]]}
    assert document["verdict"] == "proved"
    assert document["digests"] == {"design": "0" * 64, "check": "1" * 64}


@pytest.mark.parametrize("scheme", ["lossy_sensors", "late_sensors", "out_of_step", "on_change"])
def test_json_tells_the_scheme(scheme: str) -> None:
    one = ready(("reachability", scheme))
    observer = written(one, one.design)["observer"]
    assert isinstance(observer, dict)
    assert (observer["schedule"] is None) == (scheme in ("late_sensors", "on_change"))
    assert (observer["late"] is None) == (scheme != "late_sensors")
    assert set(observer["sends"]) == ({"a", "b"} if scheme == "on_change" else set())


def test_matrices_come_back() -> None:
    one = ready(("reachability", "multirate"))
    content = mat_bytes(one.portable, one.about, one.plant, one.design)
    read = loadmat(io.BytesIO(content))
    np.testing.assert_array_equal(read["K"], one.design.gain["K"].floats)
    np.testing.assert_array_equal(read["A"], one.plant.A.floats)
    own = one.design.sampling.split(one.design.gain["K"], one.plant.p)
    assert read["K_readings"].shape == (2, 2, len(own))
    np.testing.assert_array_equal(read["K_readings"][:, :, 1], own[1].floats)
    assert read["verdict"].item() == "proved"
    assert content == mat_bytes(one.portable, one.about, one.plant, one.design)
    assert b"Created on" not in content
