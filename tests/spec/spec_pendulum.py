"""A good spec that uses every key, and variations of its text."""

from __future__ import annotations

PENDULUM = """\
spec_version: 1
title: Pendulum
plant:
  states: [theta, omega]
  inputs: {u: {range: [-1, 1]}}
  parameters: {g: 1, k: "2*g"}
  A: [[0, 1], [0, 0]]
  phi: ["0", "sin(theta)/g"]
  B: [[0], ["1/8"]]
  lipschitz: [[0, 0], [1, 0]]
  domain: {theta: [-4, null], where: ["omega <= k*theta + 10"]}
  disturbance: {lower: [0, -1e-3], upper: [0, .5]}
measurement:
  C: [[1, 0]]
  sampling: {period: 0.6}
  noise: {lower: [-0.01], upper: [0.01]}
observer:
  family: reachability
  gain: {K: [["1"], [1.8361]]}
simulation:
  horizon: 20
  initial_state: [1, 0]
  initial_estimate: [0, 0]
  runs: 3
  seed: 7
  signals: {u: "0.3 + 0.1*sin(t)", d: [0, "1e-3*cos(t)"], v: ["uniform(-0.01, 0.01)"]}
  sampling_times: "0.6 + 0.1*sin(t_k)"
expect:
  - {quantity: bounds.period_max.proved, at_least: 0.6, source: "Dinh2014, Section IV"}
"""


def changed(*changes: tuple[str, str]) -> str:
    """The pendulum's text with parts replaced; each part must be there once."""
    text = PENDULUM
    for old, new in changes:
        assert text.count(old) == 1, old
        text = text.replace(old, new)
    return text
