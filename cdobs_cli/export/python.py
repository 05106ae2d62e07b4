"""One Python file that needs the standard library only: the observer as a class, and a test of its own."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence

from cdobs_cli.exact.compiled import python_function
from cdobs_cli.exact.expression import Expression
from cdobs_cli.export.about import About
from cdobs_cli.export.portable import Portable
from cdobs_cli.export.vectors import Vectors, allowed
from cdobs_cli.tableau import STAGES, TABLEAU

_OF_MATH = (
    "acos", "asin", "atan", "atan2", "cos", "cosh", "exp", "log", "log10", "sin", "sinh", "sqrt", "tan", "tanh", "ceil",
)  # fmt: skip
_SIGN = "def sign(a):\n    return 1.0 if a > 0 else -1.0 if a < 0 else 0.0\n"
_MOST_STEPS = 1_000_000

_STEP = """\
def _step(x, h, u):
    \"\"\"One step of h.\"\"\"
    slopes = []
    for row in STAGES:
        z = x if not row else tuple(
            a + h * sum(w * k[i] for w, k in zip(row, slopes)) for i, a in enumerate(x))
        slopes.append(_flow(*z, *u))
    return tuple(a + h * sum(w * k[i] for w, k in zip(WEIGHTS, slopes)) for i, a in enumerate(x))


def _flown(x, dt, u):
    \"\"\"The states dt later.\"\"\"
    count = max(1, ceil(min(dt / STEP, {most}) * (1 - 1e-9)))
    for _ in range(count):
        x = _step(x, dt / count, u)
    return x
"""

_SCHEDULE = """\
    def _next(self, which):
        \"\"\"Whether this reading comes when the law has it; and the jump it takes.\"\"\"
        if self._node is None:
            node, correction, jump = START
            if correction == which:
                self._arrived(node, which)
                return True, jump
            step = next(one for one in STEPS if one[4] == which)
            self._arrived(step[1], which)
            return False, step[5]
        while True:  # samples that did not arrive
            lost = [one for one in STEPS if one[0] == self._node and one[4] is None]
            if not lost or self._clock <= lost[0][3] + 0.5 * min(LENGTHS):
                break
            self._node, self._clock = lost[0][1], self._clock - lost[0][3]
        ages = [0.0 if s in READ[which] else age for s, age in enumerate(self._ages)]
        best, beyond = None, None
        for one in STEPS:
            if one[4] == which:
                far = max([one[2] - self._clock, self._clock - one[3], SLACK] + [
                    max(low - age, age - high) for (low, high), age in zip(AGES[one[1]], ages)])
                far += 0.0 if one[0] == self._node else 1e300
                if best is None or far < beyond:
                    best, beyond = one, far
        self._arrived(best[1], which)
        return beyond <= SLACK, best[5]

    def _arrived(self, node, which):
        self._node, self._clock = node, 0.0
        self._ages = [0.0 if s in READ[which] else age for s, age in enumerate(self._ages)]
"""

_SETTLE = """\
    def _settle(self, sender, y, u):
        \"\"\"All messages of this instant from the state before it: the sensor farthest beyond its threshold corrects
        first, and what was sent is used again as long as another correction asks for it.\"\"\"
        if not self._known:
            self._before = self._x
        self._x, self._known[sender] = self._before, y
        for rounds in range(1000):
            value, which = max(((EXCESS[k](*self._x, *u, sent)[0], -k) for k, sent in self._known.items()))
            if value < 0 and rounds:
                return
            self._x = MESSAGES[-which](*self._x, *u, self._known[-which])
"""

_LATE = """\
    def sample(self{u_argument}):
        \"\"\"The sensors are read at this instant; what they say arrives later. Returns the ticket to give then.\"\"\"
        ticket, self._ticket = self._ticket, self._ticket + 1
        self._keep([ticket, self._x, {u}, [None] * {p}])
        return ticket

    def _arrive(self, ticket, outputs, y):
        at = next((k for k, one in enumerate(self._kept) if one[0] == ticket), None)
        if at is None:
            return False
        for k, value in zip(outputs, y):
            self._kept[at][3][k] = value
        self._x = self._kept[at][1]
        for one in self._kept[at:]:
            if one[0] is None:
                self._x = _flown(self._x, one[1], one[2])
                continue
            one[1] = self._x
            if any(value is not None for value in one[3]):
                known = _expected(*self._x, *one[2])
                y = [b if a is None else a for a, b in zip(one[3], known)]
                self._x = SAMPLES[one[0] % len(SAMPLES)](*self._x, *one[2], *y)
        return True

    def _keep(self, one):
        self._kept = (self._kept + [one])[-{kept}:]
"""


def python_text(portable: Portable, about: About, told: Vectors | None, more: str = "") -> str:
    """The file. more: what comes before the test."""
    body = "\n\n".join([*_functions(portable), _STEP.format(most=_MOST_STEPS), "".join(_observer(portable))])
    body += f"\n{more}{'' if told is None else _test(portable, about, told)}"
    used = [name for name in _OF_MATH if re.search(rf"\b{name}\(", body)]
    head = [f'"""{_quoted(line)}' if k == 0 else _quoted(line) for k, line in enumerate(_header(portable, about))]
    names = [f"from math import {', '.join(used)}", *(["from math import pow as power"] if "power(" in body else [])]
    sign = f"\n\n{_SIGN}\n" if "sign(" in body else "\n"
    text = "\n".join([*head, '"""', "", *names, "", *_constants(portable, about)])
    return f"{text}\n{sign}\n{body}"


def _quoted(line: str) -> str:
    return line.replace("\\", "\\\\").replace('"', "'")


def _header(portable: Portable, about: About) -> list[str]:
    usage = ["Usage:", f"    observer = Observer({_start_arguments(portable)})"]
    u = ", u" if portable.inputs else ""
    if portable.late is not None:
        usage += [f"    ticket = observer.sample({u[2:]})   # at each instant at which the sensors are read"]
        usage += [f"    observer.arrive{_tail(word)}(ticket, y)   # as it arrives" for word, _ in portable.late.sensors]
    else:
        usage += [f"    observer.correct{_tail(one.suffix)}(y{u})" for one in portable.corrections]
    usage.append(f"    observer.predict(dt{u})   # u is held over dt")
    usage += [f"    observer.{name}()" for name in portable.estimates]
    usage.append("Run the file to compare it with a simulation.")
    return about.lines(portable, tuple(usage))


def _start_arguments(portable: Portable) -> str:
    return "lower, upper" if portable.starts_from_box else "estimate"


def _tail(suffix: str) -> str:
    return f"_{suffix}" if suffix else ""


def _constants(portable: Portable, about: About) -> list[str]:
    rows = [[float(value) for value in row] for row in TABLEAU["A"]]
    lines = [
        f"STEP = {about.step!r}",
        f"STAGES = {tuple(map(tuple, rows[:STAGES]))!r}",
        f"WEIGHTS = {tuple(rows[STAGES])!r}",
    ]
    schedule = portable.schedule
    if schedule is not None:
        steps = tuple((one.source, one.target, one.low, one.high, one.correction, one.jump) for one in schedule.steps)
        lines += [
            f"BASE = {schedule.base!r}", f"LENGTHS = {schedule.lengths!r}", f"AGES = {schedule.ages!r}",
            "# from node, to node, earliest, latest, what is read (None: nothing arrives), which gain",
            f"STEPS = {steps!r}",
            f"START = {schedule.start!r}", f"READ = {schedule.sensors!r}", "SLACK = 1e-3  # of the shortest period",
        ]  # fmt: skip
    return lines


def _functions(portable: Portable) -> Iterator[str]:
    at = (*portable.states, *portable.inputs)
    begin = [f"{end}.{name}" for end in ("lower", "upper") for name in portable.plant_states]
    if not portable.starts_from_box:
        begin = [f"initial.{name}" for name in portable.plant_states]

    def function(name: str, rows: Sequence[Expression], names: Sequence[str]) -> str:
        return python_function(name, rows, names).rstrip("\n") + "\n"

    yield function("_start", portable.start, begin)
    yield function("_flow", portable.flow, at)
    everything = [f"y.{k}" for k in range(portable.outputs)]
    if portable.late is not None:
        yield function("_expected", portable.late.expected, at)
        for k, jump in enumerate(portable.late.samples):
            yield function(f"_jump_{k}", jump, (*at, *everything))
        yield f"SAMPLES = ({''.join(f'_jump_{k}, ' for k in range(len(portable.late.samples)))})\n"
    else:
        for number, one in enumerate(portable.corrections):
            for k, jump in enumerate(one.jumps):
                yield function(f"_jump_{number}_{k}", jump, (*at, *(f"y.{output}" for output in one.outputs)))
    for name, rows in portable.estimates.items():
        yield function(f"_{name}", rows, portable.states)
    if portable.original:
        yield function("_original", tuple(portable.original.values()), portable.states)
    if portable.control:
        yield function("_control", tuple(portable.control.values()), portable.states)
    if portable.trigger is not None:
        yield function("_trigger", (portable.trigger,), portable.states)
    for word, output, row in portable.compares:
        yield function(f"_excess_{word}", (row,), (*at, f"y.{output}"))
    if portable.compares:
        excess = "".join(f"_excess_{word}, " for word, *_ in portable.compares)
        messages = "".join(f"_jump_{k}_0, " for k in range(len(portable.compares)))
        yield f"EXCESS, MESSAGES = ({excess}), ({messages})\n"


def _observer(portable: Portable) -> Iterator[str]:
    u, held = (", u", "tuple(u)") if portable.inputs else ("", "()")
    start = _start_arguments(portable)
    schedule, late = portable.schedule, portable.late
    yield f'class Observer:\n    """See above."""\n\n    def __init__(self, {start}):\n'
    yield f"        self._x = _start({', '.join(f'*{one}' for one in start.split(', '))})\n"
    if schedule is not None:
        yield f"        self._node, self._clock, self._ages = None, 0.0, [0.0] * {schedule.count}\n"
    if late is not None:
        yield "        self._kept, self._ticket = [], 0\n"
    if portable.compares:
        yield "        self._known, self._before = {}, None\n"
    yield f'\n    def predict(self, dt{u}):\n        """dt later; the inputs are held."""\n        if not dt > 0:\n'
    yield "            return\n"
    if late is not None:
        yield f"        self._keep([None, dt, {held}])\n"
    if portable.compares:
        yield "        self._known = {}\n"
    if schedule is not None:
        yield "        self._clock += dt / BASE\n        self._ages = [age + dt / BASE for age in self._ages]\n"
    yield f"        self._x = _flown(self._x, dt, {held})\n"
    if late is not None:
        for word, outputs in late.sensors:
            yield f'\n    def arrive{_tail(word)}(self, ticket, y):\n        """False where it is too late."""\n'
            yield f"        return self._arrive(ticket, {outputs!r}, y)\n"
        yield "\n" + _LATE.format(u_argument=u, u=held, p=portable.outputs, kept=late.kept)
    else:
        for number, one in enumerate(portable.corrections):
            yield f"\n    def correct{_tail(one.suffix)}(self, y{u}):\n"
            unknown = "; False where the law of samples does not have it then" if schedule is not None else ""
            yield f'        """At a sample: outputs {", ".join(str(k + 1) for k in one.outputs)}{unknown}."""\n'
            if schedule is not None:
                yield f"        known, jump = self._next({number})\n"
                jumps = "".join(f"_jump_{number}_{k}, " for k in range(len(one.jumps)))
                yield f"        self._x = ({jumps})[jump](*self._x, *{held}, *y)\n        return known\n"
            else:
                jump = f"self._x = _jump_{number}_0(*self._x, *{held}, *y)"
                yield f"        {f'self._settle({number}, y[0], {held})' if portable.compares else jump}\n"
        if portable.compares:
            yield "\n" + _SETTLE
        if schedule is not None:
            yield "\n" + _SCHEDULE
    for name in portable.estimates:
        yield f"\n    def {name}(self):\n        return _{name}(*self._x)\n"
    if portable.original:
        yield f'\n    def original(self):\n        """{", ".join(portable.original)}."""\n'
        yield "        return _original(*self._x)\n"
    if portable.control:
        names = ", ".join(portable.control)
        yield f'\n    def control(self):\n        """{names}: to be applied from a sample to the next."""\n'
        yield "        return _control(*self._x)\n"
    if portable.trigger is not None:
        yield '\n    def wants_sample(self):\n        """Whether a sample is due."""\n'
        yield "        return _trigger(*self._x)[0] >= 0\n"
    for word, *_ in portable.compares:
        yield f'\n    def sends_{word}(self, y{u}):\n        """Whether the sensor sends what it reads now."""\n'
        yield f"        return _excess_{word}(*self._x, *{held}, y)[0] >= 0\n"


_TEST = """\

def self_test(step=None, enough=float("inf")):
    \"\"\"The largest distance from the simulated estimates, in parts of their sizes; the first beyond `enough`.\"\"\"
    global STEP
    STEP = STEP if step is None else step
    observer, worst = Observer({start}), 0.0
    for kind, which, dt, u, y, ticket, expected, control in CALLS:
{calls}
        if expected:
            got = [value for rows in ({estimates}) for value in rows]
            worst = max([worst] + [abs(a - b) / c if a == a else float("inf") for a, b, c in zip(got, expected, SCALE)])
        if worst > enough:
            break
    return worst


if __name__ == "__main__":
    distance = self_test()
    print(f"largest distance from the simulation: {{distance:.3g}}")
    raise SystemExit(0 if distance <= {tolerance!r} else 1)
"""


def _test(portable: Portable, about: About, told: Vectors) -> str:
    calls = [(one.kind, one.which, one.dt, one.u, one.y, one.ticket, one.expected, one.control) for one in told.calls]
    rows = "".join(f"    {one!r},\n" for one in calls)
    u = ", u" if portable.inputs else ""
    n = len(portable.plant_states)
    start = f"START_AT[:{n}], START_AT[{n}:]" if portable.starts_from_box else "START_AT"
    lines = ["        if kind == 'predict':", f"            observer.predict(dt{u})"]
    if portable.late is not None:
        lines += ["        if kind == 'sample':", f"            observer.sample({u[2:]})"]
        for k, (word, _) in enumerate(portable.late.sensors):
            lines += [
                f"        if kind == 'arrive' and which == {k}:",
                f"            observer.arrive{_tail(word)}(ticket, y)",
            ]
    else:
        for k, one in enumerate(portable.corrections):
            lines.append(f"        if kind == 'correct' and which == {k}:")
            call = f"observer.correct{_tail(one.suffix)}(y{u})"
            known = f"            if not {call}:\n                return float('inf')"
            lines.append(known if portable.schedule is not None else f"            {call}")
    if portable.trigger is not None:
        lines += [
            "        if kind == 'asks':", "            ahead = Observer.__new__(Observer)",
            f"            ahead._x = observer._x\n            ahead.predict(dt{u})",
            "            if ahead.wants_sample() != bool(which):\n                return float('inf')",
        ]  # fmt: skip
    if portable.control:
        lines += ["        if control:", "            got = observer.control()"]
        lines += ["            worst = max([worst] + [abs(a - b) / max(1.0, abs(b)) for a, b in zip(got, control)])"]
    estimates = "".join(f"observer.{name}(), " for name in portable.estimates)
    body = _TEST.format(
        start=start,
        calls="\n".join(lines),
        estimates=estimates,
        tolerance=allowed(about.accuracy),
    )
    head = f"# what is called, which, dt, u, y, ticket, expected estimates, expected control\nCALLS = (\n{rows})\n"
    return f"\n{head}START_AT, SCALE = {told.start!r}, {told.scale!r}\n\n{body}"
