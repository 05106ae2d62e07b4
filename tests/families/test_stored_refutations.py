"""Refutations are certificates: `check` proves what `synthesize` found, and looks for nothing itself."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command import ROOT

from cdobs_cli import pipeline
from cdobs_cli.certificate import Certificate
from cdobs_cli.design import Design
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store

SPECS = ("reachability_pendulum", "reachability_pendulum_noise", "lpv_zoh_sine", "interval_pendulum_best")
SEARCHES = (
    "cdobs_cli.certify.switching.propose_for", "cdobs_cli.certify.adversary_search.propose",
    "cdobs_cli.certify.period_words.propose", "cdobs_cli.families.interval.held_loop.smallest_refuted",
    "cdobs_cli.certify.bracket.smallest_refuted",
)  # fmt: skip


def stored(name: str, folder: Path) -> pipeline.Work:
    work = pipeline.Work(load(ROOT / "specs" / f"{name}.yaml"), Store(folder), effort=0)
    pipeline.synthesize(work)
    return work


@pytest.mark.parametrize("name", SPECS)
def test_a_check_looks_for_no_counterexample(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    work = stored(name, tmp_path)

    def searched(*_: Any, **__: Any) -> Any:
        raise AssertionError("a check searches")

    for search in SEARCHES:
        monkeypatch.setattr(search, searched)
    check = pipeline.check(work)
    ends = {key: bound.refuted for key, bound in check.bounds.items() if bound.refuted not in (None, "inf")}
    assert {"period_max", "held_loop_period_max"} & ends.keys()
    if "noise" in name:
        assert all(f"error.{state}" in ends for state in work.spec.plant.states)


@pytest.mark.parametrize("name", SPECS)
def test_without_them_less_is_refuted_and_nothing_more_is_proved(name: str, tmp_path: Path) -> None:
    work = stored(name, tmp_path)
    assert work.design is not None
    whole, spec = pipeline.check(work), work.spec

    def is_refutation(one: Certificate) -> bool:
        return one.method in ("counterexample", "attained", "cells_of_gains", "held_loop_lost")

    assert any(map(is_refutation, work.design.certificates))
    kept = tuple(one for one in work.design.certificates if not is_refutation(one))
    bare: Design = replace(work.design, certificates=kept)
    less = spec.observer.certify(pipeline.plant_of(spec, bare), bare, 0)
    for key, bound in less.bounds.items():
        assert bound.proved == whole.bounds[key].proved
        assert bound.refuted is None or bound.refuted == whole.bounds[key].refuted
    assert len([b for b in less.bounds.values() if b.refuted]) < len([b for b in whole.bounds.values() if b.refuted])
