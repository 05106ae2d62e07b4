"""A Python file that makes a discrete system of python-control: one step is a sample and the flow to the next one."""

from __future__ import annotations

from cdobs_cli.errors import UsageError
from cdobs_cli.exact.expression import ZERO, Expression, Number
from cdobs_cli.exact.rational import simplify
from cdobs_cli.export.about import About
from cdobs_cli.export.portable import Portable
from cdobs_cli.export.python import python_text
from cdobs_cli.export.vectors import Vectors
from cdobs_cli.sampling import SamplingLaw

_SYSTEM = '''\

PERIOD = {period!r}  # where the law allows several, the longest without a loss
INPUTS = {inputs!r}
OUTPUTS = {outputs!r}
STATES = {states!r}


def initial({start}):
    """The state of the system at t = 0, before the first sample."""
    return _start({given})


def _update(t, x, u, params):
    after = _jump_0_0(*x, *u[{p}:], *u[:{p}])
    return _flown(after, PERIOD, tuple(u[{p}:]))


def _output(t, x, u, params):
    after = _jump_0_0(*x, *u[{p}:], *u[:{p}])
    return {estimates}


def system(name={name!r}):
    """The observer as a discrete system with time step PERIOD: what is measured and the inputs, held until the next
    sample, go in; the estimate just after the sample comes out. Where outputs are functions of inputs, these are the
    inputs of that moment."""
    import control

{built}
'''
_NONLINEAR = """\
    return control.NonlinearIOSystem(
        _update, _output, inputs=INPUTS, outputs=OUTPUTS, states=STATES, dt=PERIOD, name=name)"""
_LINEAR = """\
    def column(of, number):
        unit = [1.0 if k == number else 0.0 for k in range(len(STATES) + len(INPUTS))]
        return of(0.0, tuple(unit[:len(STATES)]), tuple(unit[len(STATES):]), None)

    def matrix(of, first, count):
        columns = [column(of, first + k) for k in range(count)]
        return [list(row) for row in zip(*columns)]

    n, m = len(STATES), len(INPUTS)
    return control.StateSpace(
        matrix(_update, 0, n), matrix(_update, n, m), matrix(_output, 0, n), matrix(_output, n, m), PERIOD,
        inputs=INPUTS, outputs=OUTPUTS, states=STATES, name=name)"""


def control_text(portable: Portable, about: About, told: Vectors | None, law: SamplingLaw) -> str:
    """The file.

    Raises: UsageError where samples are not all alike, or have no period.
    """
    if len(portable.corrections) > 1 or portable.late or portable.trigger is not None or portable.compares:
        what = "a system of python-control has one time step and one kind of sample"
        raise UsageError(f"{what}, this observer is sampled {about.law}; write --to python")
    outputs = [f"{word}_{state}" for word in portable.estimates for state in portable.plant_states]
    start = "lower, upper" if portable.starts_from_box else "estimate"
    text = _SYSTEM.format(
        period=float(law.period), p=portable.outputs, name=portable.name,
        inputs=[*(f"y{k + 1}" for k in range(portable.outputs)), *portable.inputs], outputs=outputs,
        states=[name.replace(".", "_") for name in portable.states], start=start,
        given=", ".join(f"*{one}" for one in start.split(", ")),
        estimates=" + ".join(f"_{word}(*after)" for word in portable.estimates),
        built=_LINEAR if is_linear(portable) else _NONLINEAR,
    )  # fmt: skip
    return python_text(portable, about, told, text)


def is_linear(portable: Portable) -> bool:
    """Whether a step is a linear map of states, inputs and measurements."""
    names = [*portable.states, *portable.inputs, *(f"y.{k}" for k in range(portable.outputs))]
    rows = [*portable.flow, *portable.corrections[0].jumps[0], *portable.rows]
    return all(_is_linear(row, names) for row in rows)


def _is_linear(row: Expression, names: list[str]) -> bool:
    slopes = (simplify(row.derivative(name)) for name in names)
    at_zero = simplify(row.substitute(dict.fromkeys(names, ZERO)))
    return all(isinstance(slope, Number) for slope in slopes) and at_zero == ZERO
