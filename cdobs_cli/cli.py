"""The commands: parse, call, print, exit code. Nothing heavy is imported before a command runs."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from enum import StrEnum
from inspect import Signature, signature
from io import StringIO, TextIOWrapper
from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from cdobs_cli import __version__
from cdobs_cli.console import Console, LostStreamError, say
from cdobs_cli.errors import INTERRUPTED, CdobsError, ExitCode, UsageError, untold
from cdobs_cli.outcome import STAGES
from cdobs_cli.printable import line, lines

app = typer.Typer(
    name="cdobs",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    help="Design and prove observers for continuous-time plants measured at discrete instants.",
    epilog="Exit codes: 0 everything holds, 1 a finding, 2 the spec or command line is wrong, 3 the tool failed.",
)


Format = StrEnum("Format", "text json junit sarif github")
Plain = StrEnum("Plain", "text json")  # of what is not about specs
Target = StrEnum("Target", "c99 python mat json control fmu proof")
Precision = StrEnum("Precision", "double float")
Stages = tuple[str, ...]
_INTERRUPTED = 130  # what typer makes of Ctrl-C


Out = Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where results go, one folder a spec.")]
Effort = Annotated[int, typer.Option(min=0, max=3, help="Refinement of searches and counterexamples.")]
Force = Annotated[bool, typer.Option("--force", help="Redo what is current.")]
Output = Annotated[Format, typer.Option("--format", help="Format of stdout.")]
Quiet = Annotated[bool, typer.Option("-q", "--quiet", help="Print findings only.")]
Verbose = Annotated[bool, typer.Option("-v", "--verbose", help="Say where an internal error happened.")]
Executor = Annotated[
    str | None,
    typer.Option(metavar="dask=ADDRESS", help="Work on the cluster of this Dask scheduler (needs cdobs[dask])."),
]


def _at_a_time(what: str) -> Any:
    return typer.Option(min=1, max=256, metavar="N", help=f"{what} at a time.")


def _seconds(each: str) -> Any:
    return typer.Option(min=0, metavar="S", help=f"Seconds {each}; what is not finished is undecided.")


NoColor = Annotated[bool, typer.Option("--no-color", help="Plain text (also with NO_COLOR).")]


def _common(
    paths: Annotated[
        list[Path], typer.Argument(metavar="PATH..", help="A spec, or a directory: every *.yaml and *.yml below it.")
    ],
    out: Out = Path("results"),
    effort: Effort = 1,
    force: Force = False,
    jobs: Annotated[int, _at_a_time("Specs, or batches of runs of a single one,")] = 1,
    time_limit: Annotated[float | None, _seconds("a spec")] = None,
    output: Output = Format.text,
    quiet: Quiet = False,
    verbose: Verbose = False,
    no_color: NoColor = False,
) -> None:
    """What the commands about specs take."""


def _about_specs(
    name: str, *, without: tuple[str, ...] = ()
) -> Callable[[Callable[..., Stages]], Callable[..., Stages]]:
    """A command that carries out the stages which its function names, on every spec of the paths; it takes the common
    options and the function's own."""

    def registered(stages_of: Callable[..., Stages]) -> Callable[..., Stages]:
        own = signature(stages_of, eval_str=True).parameters
        common = signature(_common, eval_str=True).parameters
        every = [*(option for option in common.values() if option.name not in without), *own.values()]
        every.sort(key=lambda option: option.default is not Signature.empty)  # what must be given comes first

        def command(paths: list[Path], output: Format, quiet: bool, no_color: bool, **settings: Any) -> None:
            from cdobs_cli.batch import Settings, carry_out

            stages = stages_of(**{option: settings[option] for option in own})
            console = Console(output.value, quiet=quiet, no_color=no_color, verbose=settings["verbose"])
            raise typer.Exit(carry_out(name, paths, stages, Settings(**settings), console))

        command.__doc__ = stages_of.__doc__
        command.__annotations__ = {option.name: option.annotation for option in every}
        command.__signature__ = Signature(every)  # type: ignore[attr-defined]
        app.command(name)(command)
        return stages_of

    return registered


@app.callback(invoke_without_command=False)
def options(
    version: Annotated[
        bool,
        typer.Option("--version", is_eager=True, help="Print the version.", callback=lambda value: _version(value)),
    ] = False,
) -> None:
    """Design and prove observers for continuous-time plants measured at discrete instants."""


def _version(value: bool) -> None:
    if value:
        say(f"cdobs {__version__}")
        raise typer.Exit


@app.command()
def init(
    family: Annotated[
        str, typer.Argument(metavar="[FAMILY]", help="reachability, lpv_zoh, updated_sampling, interval or auto.")
    ] = "auto",
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", help="Write here instead of stdout.")
    ] = None,
) -> None:
    """Print a commented spec that runs as it is: of a family, or the shortest that leaves the family open.

    With -o it is written, and beside it the JSON Schema by which editors check it.
    """
    from cdobs_cli.scaffold import example, write_new

    text = example(family)
    say(text.removesuffix("\n")) if out is None else write_new(out, text)


@_about_specs("validate", without=("effort", "force"))
def validate() -> Stages:
    """Read and check specs; no linear algebra."""
    return ()


@_about_specs("synthesize")
def synthesize() -> Stages:
    """Find the gain (or take the given one) and a certificate for each period wanted: design.json."""
    return ("synthesize",)


@_about_specs("check")
def check() -> Stages:
    """Prove the stored certificates and the slopes, search counterexamples: check.json."""
    return ("check",)


@_about_specs("simulate")
def simulate(
    witness: Annotated[
        str | None, typer.Option(metavar="ID", help="Run the counterexample of this claim instead, or of period_max.")
    ] = None,
    resume: Annotated[bool, typer.Option("--resume", help="Go on where a killed simulation of many runs was.")] = False,
) -> Stages:
    """Run plant and observer together: simulation.npz, simulation.json, figures."""
    return ("replay",) if witness else ("simulate",)


@_about_specs("report")
def report() -> Stages:
    """Write report.md and report.html from what is there."""
    return ("report",)


@_about_specs("export")
def export(
    to: Annotated[
        Target,
        typer.Option(
            "--to",
            help="What is written: C, a Python file, matrices, data, python-control, an FMU, a proof with its checker.",
        ),
    ],
    precision: Annotated[Precision, typer.Option(help="Of the numbers in C.")] = Precision.double,
) -> Stages:
    """Write the designed observer for use elsewhere, into <out>/<stem>/export: needs a current design and check."""
    return ("export",)


@_about_specs("run")
def run_all(
    no_report: Annotated[bool, typer.Option("--no-report", help="Leave figures and pages out.")] = False,
    executor: Executor = None,
) -> Stages:
    """Carry out all stages in order."""
    return tuple(stage for stage in STAGES if not (no_report and stage == "report"))


@app.command()
def sweep(
    spec: Annotated[Path, typer.Argument(metavar="SPEC", help="The spec whose fields change.")],
    sets: Annotated[
        list[str],
        typer.Option(
            "--set", metavar="FIELD=VALUES",
            help="A field as a dotted path, and v1,v2,.. or lo:hi:count; several fields make a grid.",
        ),
    ],
    out: Out = Path("results"),
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="Carry out every N-th point only, from the I-th on.")
    ] = None,
    merge: Annotated[
        bool, typer.Option("--merge", help="Write table and figures from what the parts left; nothing is computed.")
    ] = False,
    effort: Effort = 1,
    force: Force = False,
    jobs: Annotated[int, _at_a_time("Points")] = 1,
    time_limit: Annotated[float | None, _seconds("a point")] = None,
    executor: Executor = None,
    output: Output = Format.text,
    quiet: Quiet = False,
    verbose: Verbose = False,
    no_color: NoColor = False,
) -> None:  # fmt: skip
    """Design and check a spec at every point of a grid over its fields: one CSV, figures.

    What stands is not done again: a sweep that was killed goes on.
    """
    from cdobs_cli.batch import Settings
    from cdobs_cli.sweep.run import carry_out

    if merge and shard is not None:
        raise UsageError("--merge puts all parts together; leave --shard away")
    console = Console(output.value, quiet=quiet, no_color=no_color, verbose=verbose)
    settings = Settings(out, effort, force, verbose, jobs, time_limit, executor=executor)
    raise typer.Exit(carry_out(spec, sets, settings, console, shard=shard, merge=merge))


@app.command()
def compare(
    paths: Annotated[list[Path], typer.Argument(metavar="PATH..", help="Specs of one plant, or directories of them.")],
    out: Out = Path("results"),
    effort: Effort = 1,
    force: Force = False,
    jobs: Annotated[int, _at_a_time("Observers")] = 1,
    time_limit: Annotated[float | None, _seconds("an observer")] = None,
    output: Output = Format.text,
    quiet: Quiet = False,
    verbose: Verbose = False,
    no_color: NoColor = False,
) -> None:
    """Compare observers of one plant: the specs, the families that take it, baselines. Table, CSV, page, figure.

    Baselines (an extended Kalman filter, a copy of the model with a placed gain) are marked where nothing is proved.
    """
    from cdobs_cli.batch import Settings
    from cdobs_cli.compare.run import carry_out

    console = Console(output.value, quiet=quiet, no_color=no_color, verbose=verbose)
    raise typer.Exit(carry_out(paths, Settings(out, effort, force, verbose, jobs, time_limit), console))


@app.command()
def explain(
    identifier: Annotated[
        str | None,
        typer.Argument(metavar="ID", help="A claim, bound, verdict, message or topic; none: all."),
    ] = None,
    spec: Annotated[
        Path | None, typer.Argument(metavar="SPEC", help="Tell also what the results of this spec say of it.")
    ] = None,
    out: Annotated[Path, typer.Option("-o", "--out", metavar="DIR", help="Where results are.")] = Path("results"),
    output: Annotated[Plain, typer.Option("--format", help="Format of stdout.")] = Plain.text,
) -> None:
    """Explain what a claim, bound, verdict or message means, and what to do next."""
    from cdobs_cli import explanation
    from cdobs_cli.explain.pages import pages

    if identifier is None:
        found: Any = [page.document() for page in pages()]
        text = explanation.list_text()
    else:
        known, page = explanation.explained(identifier)
        said = None if spec is None else explanation.stored(known, page, spec, out)
        found = {"id": known, **page.document(), "results": None if said is None else said.document()}
        text = explanation.page_text(known, page, said)
    if output is Plain.json:
        import json

        say(json.dumps(found, indent=1))
    else:
        say(text)


@app.command()
def schema(
    out: Annotated[
        Path | None, typer.Option("-o", "--out", metavar="FILE", help="Write here instead of stdout.")
    ] = None,
) -> None:
    """Print the JSON Schema of a spec, for YAML editors."""
    from cdobs_cli.scaffold import schema_text, write_schema

    say(schema_text()) if out is None else write_schema(out)


@app.command()
def theorems(output: Annotated[Plain, typer.Option("--format", help="Format of stdout.")] = Plain.text) -> None:
    """List what is implemented: name, source, equation, file:line."""
    from cdobs_cli.catalogue import catalogue, catalogue_text

    if output is Plain.json:
        import json

        say(json.dumps([entry.document() for entry in catalogue()], indent=1))
    else:
        say(catalogue_text().removesuffix("\n"))


def run() -> None:
    """Parse the command line and exit: usage errors are 2, errors with a message keep their code."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    lost = _closed_streams()
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, TextIOWrapper):
            stream.reconfigure(errors="backslashreplace")  # names of files need not be text
    try:
        code = _lost(lost[0], lost) if lost else _code()
    except LostStreamError as error:
        code = _lost(error, [error])
    sys.exit(code)


def _closed_streams() -> list[LostStreamError]:
    """Standard streams that were closed before this process began; their descriptors lead nowhere from now on,
    so that no file that is opened later gets what is printed."""
    lost = []
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(number)
        except OSError:
            _leads_nowhere(number)
            if number:
                lost.append(LostStreamError(name, ValueError()))
    sys.stdout, sys.stderr = (stream or StringIO() for stream in (sys.stdout, sys.stderr))
    return lost


def _leads_nowhere(number: int) -> None:
    nowhere = os.open(os.devnull, os.O_RDWR)
    if nowhere != number:
        os.dup2(nowhere, number)
        os.close(nowhere)


def _lost(error: LostStreamError, lost: list[LostStreamError]) -> ExitCode:
    """Told on the stream that is left, if one is; nobody is told where a reader of stdout went away."""
    if error.unread and error.name == "stdout":
        lost = []
    names = {one.name for one in lost}
    try:
        if lost:
            told = "" if "stderr" in names else f"cdobs: {error}"
            _refused(told, str(error), ExitCode.FAILED, document="stdout" not in names)
    except LostStreamError:
        names = {"stdout", "stderr"}
    for number, name in ((1, "stdout"), (2, "stderr")):
        if name in names or error.unread:
            _leads_nowhere(number)  # what Python would still write on its way out
    return ExitCode.FAILED


def _code() -> int:
    try:
        code = app(standalone_mode=False)
    except LostStreamError:
        raise
    except CdobsError as error:
        return _refused(f"cdobs: {error}", str(error), error.exit_code)
    except (KeyboardInterrupt, typer.Abort):
        code = _INTERRUPTED
    except SystemExit as error:  # typer's way out, with 1, where nobody reads stdout any more
        raise LostStreamError("stdout", BrokenPipeError()) from error
    except Exception as error:
        return _unexpected(error)
    if code == _INTERRUPTED:
        return _refused(f"cdobs: {INTERRUPTED}", INTERRUPTED, ExitCode.FAILED)
    return code if isinstance(code, int) else ExitCode.HOLDS


def _unexpected(error: Exception) -> ExitCode:
    show = getattr(error, "show", None)
    if show is not None:  # a mistake in the command line, told by typer
        told = StringIO()
        show(told)
        say(lines(told.getvalue().removesuffix("\n")), aside=True)
        return _refused("", getattr(error, "format_message", error.__str__)(), ExitCode.INVALID)
    if {"-v", "--verbose"} & set(sys.argv):
        import traceback

        say(lines("".join(traceback.format_exception(error))), aside=True)
    return _refused(f"cdobs: {untold(error)}", untold(error), ExitCode.FAILED)


def _refused(told: str, text: str, code: ExitCode, *, document: bool = True) -> ExitCode:
    """What ends a command as a whole: a line for people, and a document where one was asked for."""
    if told:
        say(line(told), aside=True)
    words = [word for argument in sys.argv[1:] for word in argument.split("=", 1)]
    wanted = words[words.index("--format") + 1] if "--format" in words[:-1] else "text"
    if document and wanted in {one.value for one in Format} - {"text"}:
        from cdobs_cli.formats import render
        from cdobs_cli.outcome import Message, Result

        status: Literal["invalid", "failed"] = "invalid" if code == ExitCode.INVALID else "failed"
        message = Message("error", text, rule="command" if status == "invalid" else "tool")
        command = next((word for word in sys.argv[1:] if not word.startswith("-")), "")
        say(render(wanted, command, [Result("command line", status, (message,))], code))
    return code
