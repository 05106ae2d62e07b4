"""Points carried out by an engine, each once: what stands is taken as it is, and each result is stored as it comes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import replace
from functools import partial

from cdobs_cli.batch import Settings, engine_of, run
from cdobs_cli.console import Console
from cdobs_cli.errors import INTERRUPTED
from cdobs_cli.outcome import Result, failure
from cdobs_cli.sweep.points import Point


def carried_out(
    points: Sequence[Point], names: Sequence[str], stages: tuple[str, ...], settings: Settings, console: Console, *,
    shown: bool = True,
) -> tuple[list[Result], bool]:  # fmt: skip
    """By the engine of the settings. Returns what became of the points, by their names, and whether all were carried
    out; `shown`: each with a line.

    A point that ended at a limit or by a crash does not stand: it is done again. After an interrupt the rest is told
    as failed.

    Raises: ToolError, where a result cannot be stored.
    """
    results: dict[int, Result] = {}
    with console.following(list(names)) as follow:
        settings = replace(settings, followed=follow.live is not None, workers=1)

        def ended(number: int, result: Result) -> None:
            results[number] = replace(result, spec=names[number])
            if shown:
                follow.ended(number, results[number])
            else:
                follow.over(number)

        todo = []
        for number, point in enumerate(points):
            row = None if settings.force else point.row()
            if row is None or row.passing:
                todo.append(number)
                point.prepare()
            else:
                ended(number, point.result(names[number], row))
        try:
            with closing(
                engine_of(settings)(
                    [points[number].job for number in todo], partial(run, stages=stages, settings=settings),
                    workers=settings.jobs, time_limit=settings.time_limit,
                    started=lambda at: follow.started(todo[at]), heard=lambda at, words: follow.heard(todo[at], words),
                )
            ) as running:  # fmt: skip
                for at, result in running:
                    points[todo[at]].keep(result)
                    ended(todo[at], result)
        except KeyboardInterrupt:
            console.warn(INTERRUPTED)
    told = [results.get(number) or failure(name, INTERRUPTED) for number, name in enumerate(names)]
    return told, len(results) == len(points)
