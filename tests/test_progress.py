"""What is told while a search goes on, and what is left when its time is over."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from fractions import Fraction
from pathlib import Path

import pytest
from command import PENDULUM, made
from designing import designed

from cdobs_cli import progress
from cdobs_cli.batch import Settings, run
from cdobs_cli.certify import search
from cdobs_cli.exact.numbers import Exact
from cdobs_cli.isolation import each_isolated
from cdobs_cli.outcome import Job, Result
from cdobs_cli.progress import TimeIsUp, Watch
from cdobs_cli.spec.model import load
from cdobs_cli.store import Store


def test_nobody_is_told_where_nobody_waits() -> None:
    with progress.stage("check"), progress.searching():
        progress.doing("clock")
        progress.called()
    assert not progress.is_late()


def test_words_say_stage_method_calls_and_what_is_proved(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("cdobs_cli.progress._EVERY", 0.0)
    told: list[str] = []
    with progress.watched(told.append) as watch:
        with progress.stage("synthesize"):
            progress.doing("clock, T = 0.5")
            progress.called()
            progress.proved("clock, T = 0.5")
            progress.doing("clock, T = 1")
        with progress.stage("check"):
            pass
    assert told == [
        "synthesize",
        "synthesize: clock, T = 0.5",
        "synthesize: clock, T = 0.5, 1 solver calls",
        "synthesize: clock, T = 1, 1 solver calls; proved: clock, T = 0.5",
        "check",
    ]
    assert watch.stages.keys() == {"synthesize", "check"}


def test_the_time_is_over_within_searches_only() -> None:
    with progress.watched(None, 0.0):
        progress.called()
        assert progress.is_late()
        with pytest.raises(TimeIsUp), progress.searching():
            progress.called()
        progress.doing("a proof")


def test_a_search_that_is_cut_gives_the_best_so_far() -> None:
    def proving(most: int) -> Callable[[Exact], float | None]:
        calls = iter(range(most))

        def prove(value: Exact) -> float | None:
            if next(calls, None) is None:
                raise TimeIsUp
            return float(value) if float(value) <= 3.3 else None

        return prove

    width = Fraction(1, 1000)
    met = [search.longest(proving(most), Exact(1), width) for most in range(1, 20)]
    assert met == sorted(met) and met[0] == 1.0 and met[-1] == pytest.approx(3.3, rel=1e-3)  # type: ignore[type-var]
    with pytest.raises(TimeIsUp):
        search.longest(proving(0), Exact(1), width)


@pytest.fixture
def cut_after(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[int], None]]:
    """Searches of this test end after so many looks at the watch."""

    def after(count: int) -> None:
        looks = iter(range(count))

        def look(watch: Watch) -> None:
            if watch._searches and next(looks, None) is None:
                watch.ends = 0.0
                raise TimeIsUp

        monkeypatch.setattr(Watch, "look", look)

    with progress.watched():
        yield after


@pytest.mark.parametrize("objective", ["given_period", "max_period"])
def test_a_design_that_is_cut_is_proved_or_open_and_never_wrong(
    tmp_path: Path, cut_after: Callable[[int], None], objective: str
) -> None:
    text = PENDULUM.replace("  method: set\n", f"  objective: {objective}\n").replace("period: 0.6", "max_period: 0.4")
    (tmp_path / "s.yaml").write_text(text)
    spec = load(tmp_path / "s.yaml")
    verdicts = []
    for count in (0, 3, 10, 30, 60, 1000):
        cut_after(count)
        design = designed(spec.observer, spec.plant, 0)
        check = spec.observer.certify(spec.plant, design, 0)
        assert design.outcome in ("found", "short", "none") and check.verdict != "refuted"
        assert design.outcome != "none" or "--time-limit" in str(design.reason)
        verdicts.append(check.verdict)
    assert verdicts[0] == "undecided" and verdicts[-1] == "proved"


def test_a_cut_design_is_told_kept_and_looked_for_again(tmp_path: Path) -> None:
    (tmp_path / "s.yaml").write_text(PENDULUM)
    job = Job(tmp_path / "s.yaml", tmp_path / "out")
    cut = run(job, ("synthesize",), Settings(out=tmp_path, effort=0, time_limit=1e-9), lambda _: None)
    assert cut.design is not None and cut.design["cut"] is True
    assert any("--time-limit" in message.text and message.severity == "warning" for message in cut.messages)
    stored = Store(tmp_path / "out").design()
    assert stored is not None and stored.cut
    whole = run(job, ("synthesize",), Settings(out=tmp_path, effort=0))
    assert whole.design is not None and "cut" not in whole.design and whole.design["outcome"] == "found"


def test_stages_have_their_times(tmp_path: Path) -> None:
    result = made(tmp_path, PENDULUM, ("synthesize", "check"))
    assert result.stages.keys() == {"synthesize", "check"} and all(seconds > 0 for seconds in result.stages.values())


def call(job: Job, *, tell: Callable[[Result | str], None]) -> Result:
    tell(f"about {job.spec}")
    time.sleep(0.01)
    return Result(str(job.spec), "ok")


def test_words_of_workers_reach_whoever_waits() -> None:
    jobs, heard = [Job(Path(name), Path("out") / name) for name in "abc"], []
    ended = each_isolated(
        jobs, call, workers=2, time_limit=None, started=lambda _: None, heard=lambda *words: heard.append(words)
    )
    assert {result.status for _, result in ended} == {"ok"}
    assert sorted(heard) == [(0, "about a"), (1, "about b"), (2, "about c")]
