"""C99 without allocation and globals: header and source of the observer."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any

from cdobs_cli.codegen import c_function, number, prelude
from cdobs_cli.exact.expression import Expression
from cdobs_cli.export.about import About
from cdobs_cli.export.portable import Correction, Portable, Schedule
from cdobs_cli.tableau import STAGES, TABLEAU

_STEP = """\
static void step(real *x, real h, const real *u)
{
    static const real a[STAGES * (STAGES + 1) / 2] = {A};
    real k[STAGES][SIZE], z[SIZE], sum;
    const real *row = a;
    int s, j, i;
    for (s = 0; s <= STAGES; s++) {
        for (i = 0; i < SIZE; i++) {
            sum = 0;
            for (j = 0; j < s; j++)
                sum += row[j] * k[j][i];
            z[i] = x[i] + h * sum;
        }
        row += s;
        if (s < STAGES)
            flow(z, u, k[s]);
    }
    memcpy(x, z, sizeof z);
}

static void flown(real *x, real dt, const real *u)
{
    real wanted = dt / LONGEST * NEARLY_ONE;
    long count = wanted < 1 ? 1 : wanted < 1000000 ? (long)wanted + 1 : 1000000, i;
    for (i = 0; i < count; i++)
        step(x, dt / (real)count, u);
}
"""

_SCHEDULE = """\
static void arrived(struct state *s, int node, int which)
{
    int i;
    s->node = node;
    s->clock = 0;
    for (i = 0; i < AGES; i++)
        if (reads[which][i])
            s->age[i] = 0;
}

/* Which jump it is; *known: whether the law of samples has this reading now. */
static int next(struct state *s, int which, int *known)
{
    int i, j, best = -1;
    real beyond = 0, far, age;
    *known = 0;
    if (s->node < 0) {
        *known = which == START_READS;
        for (i = 0; i < STEPS && best < 0; i++)
            if (steps[i].reads == which)
                best = i;
        arrived(s, *known ? START_NODE : steps[best].to, which);
        return *known ? START_JUMP : steps[best].jump;
    }
    for (;;) { /* samples that did not arrive */
        for (i = 0; i < STEPS; i++)
            if (steps[i].from == s->node && steps[i].reads < 0)
                break;
        if (i == STEPS || s->clock <= steps[i].high + SHORTEST / 2)
            break;
        s->node = steps[i].to;
        s->clock -= steps[i].high;
    }
    for (i = 0; i < STEPS; i++) {
        if (steps[i].reads != which)
            continue;
        far = max(max(steps[i].low - s->clock, s->clock - steps[i].high), SLACK);
        for (j = 0; j < AGES; j++) {
            age = reads[which][j] ? 0 : s->age[j];
            far = max(far, max(ages[steps[i].to][j][0] - age, age - ages[steps[i].to][j][1]));
        }
        if (steps[i].from != s->node)
            far += ELSEWHERE;
        if (best < 0 || far < beyond) {
            best = i;
            beyond = far;
        }
    }
    arrived(s, steps[best].to, which);
    *known = beyond <= SLACK;
    return steps[best].jump;
}
"""

_SETTLE = """\
/* All messages of this instant from the state before it: the sensor farthest beyond its threshold corrects first, and
 * what was sent is used again as long as another correction asks for it. */
static void settled(struct state *s, int sender, real y, const real *u)
{
    real value, most, after[SIZE];
    int k, far, rounds, some = 0;
    for (k = 0; k < SENDERS; k++)
        some |= s->known[k];
    if (some)
        memcpy(s->x, s->before, sizeof s->x);
    else
        memcpy(s->before, s->x, sizeof s->x);
    s->known[sender] = 1;
    s->sent[sender] = y;
    for (rounds = 0; rounds < 1000; rounds++) {
        far = -1;
        most = 0;
        for (k = 0; k < SENDERS; k++) {
            if (!s->known[k])
                continue;
            excess(k, s->x, u, &s->sent[k], &value);
            if ((value >= 0 || rounds == 0) && (far < 0 || value > most)) {
                far = k;
                most = value;
            }
        }
        if (far < 0)
            return;
        message(far, s->x, u, &s->sent[far], after);
        memcpy(s->x, after, sizeof after);
    }
}
"""

_LATE = """\
static struct kept *keep(struct state *s)
{
    if (s->count == KEPT) {
        memmove(s->kept, s->kept + 1, (KEPT - 1) * sizeof s->kept[0]);
        s->count--;
    }
    memset(&s->kept[s->count], 0, sizeof s->kept[0]);
    return &s->kept[s->count++];
}

static void corrected(real *x, struct kept *one)
{
    real y[OUTPUTS], after[SIZE];
    int k, some = 0;
    memcpy(one->x, x, sizeof one->x);
    expected(x, one->u, y);
    for (k = 0; k < OUTPUTS; k++)
        if (one->there[k]) {
            y[k] = one->y[k];
            some = 1;
        }
    if (!some)
        return;
    sampled(one->pattern, x, one->u, y, after);
    memcpy(x, after, sizeof after);
}

static int arrive(struct state *s, unsigned long ticket, const int *outputs, int count, const real *y)
{
    int i, k;
    for (i = 0; i < s->count && !(s->kept[i].pattern >= 0 && s->kept[i].ticket == ticket); i++)
        ;
    if (i == s->count)
        return 0;
    for (k = 0; k < count; k++) {
        s->kept[i].y[outputs[k]] = y[k];
        s->kept[i].there[outputs[k]] = 1;
    }
    memcpy(s->x, s->kept[i].x, sizeof s->x);
    for (; i < s->count; i++) {
        if (s->kept[i].pattern < 0)
            flown(s->x, s->kept[i].dt, s->kept[i].u);
        else
            corrected(s->x, &s->kept[i]);
    }
    return 1;
}
"""


class C99:
    """An observer in C; real: `double` or `float`."""

    def __init__(self, portable: Portable, about: About, real: str) -> None:
        self.portable, self.about, self.real = portable, about, real
        self.name, self.upper = portable.name, portable.name.upper()
        self.u = f", const {self.name}_real *u" if portable.inputs else ""
        at = {name: f"x[{i}]" for i, name in enumerate(portable.states)}
        self.at_x = at
        self.at_xu = at | {name: f"u[{j}]" for j, name in enumerate(portable.inputs)}

    def constant(self, value: float) -> str:
        """As C reads it."""
        return number(value, self.real)

    def comment(self, usage: Sequence[str] = ()) -> list[str]:
        """What every file says first."""
        lines = self.about.lines(self.portable, tuple(usage))
        return ["/*", *(f" * {_plain(line)}".rstrip() for line in lines), " */"]

    def declarations(self) -> Iterator[tuple[str, str]]:
        """Every public function: its comment, and itself without the semicolon."""
        portable, name, real, u = self.portable, self.name, f"{self.name}_real", self.u
        n, s, seen = len(portable.plant_states), f"{self.name}_state *s", f"const {self.name}_state *s"
        states = ", ".join(portable.plant_states)
        if portable.starts_from_box:
            yield f"Begin at t = 0 with x(0) in [lower, upper] ({n} numbers each: {states}).", (
                f"void {name}_init({s}, const {real} *lower, const {real} *upper)")  # fmt: skip
        else:
            yield f"Begin at t = 0 with an estimate of {states}.", f"void {name}_init({s}, const {real} *estimate)"
        held = f" u: {', '.join(portable.inputs)}, held over dt." if portable.inputs else ""
        yield f"dt later.{held}", f"void {name}_predict({s}, {real} dt{u})"
        if portable.late is not None:
            yield "The sensors are read at this instant; returns the ticket to give as their values arrive.", (
                f"unsigned long {name}_sample({s}{u})")  # fmt: skip
            for word, outputs in portable.late.sensors:
                yield f"The values of {_listed(outputs)} arrive; 0 where that is too late.", (
                    f"int {name}_arrive{tail(word)}({s}, unsigned long ticket, const {real} *y)")  # fmt: skip
        for one in () if portable.late is not None else portable.corrections:
            before = " with the inputs as they were up to it" if portable.inputs else ""
            told = f"A sample of {_listed(one.outputs)}{before}"
            if portable.schedule is not None:
                yield f"{told}; 0 where the law of samples does not have it then.", (
                    f"int {name}_correct{tail(one.suffix)}({s}, const {real} *y{u})")  # fmt: skip
            else:
                yield f"{told}.", f"void {name}_correct{tail(one.suffix)}({s}, const {real} *y{u})"
        for estimate in portable.estimates:
            yield f"{n} numbers: {states}.", f"void {name}_{estimate}({seen}, {real} *out)"
        if portable.original:
            yield f"The same as {', '.join(portable.original)}.", f"void {name}_original({seen}, {real} *out)"
        if portable.control:
            yield f"{', '.join(portable.control)}, to be applied from a sample to the next: ask after a correction.", (
                f"void {name}_control({seen}, {real} *out)")  # fmt: skip
        if portable.trigger is not None:
            yield "Whether a sample is due.", f"int {name}_wants_sample({seen})"
        for word, output, _ in portable.compares:
            yield f"Whether the sensor sends y {output + 1} as it reads it now.", (
                f"int {name}_sends_{word}({seen}, {real} y{u})")  # fmt: skip
        for k, (_, sentence) in enumerate(portable.stops):
            yield f"Whether this has come true: {sentence}.", f"int {name}_stops_{k + 1}({seen})"

    def header(self) -> str:
        """The .h file."""
        portable, name = self.portable, self.name
        beside: list[str] = []
        fields = [f"{name}_real x[{len(portable.states)}];"]
        if portable.schedule is not None:
            fields += ["int node;", f"{name}_real clock, age[{max(1, portable.schedule.count)}];"]
        if portable.late is not None:
            inputs = max(1, len(portable.inputs))
            kept = ["int pattern;", "unsigned long ticket;", f"{name}_real dt, x[{len(portable.states)}], u[{inputs}];",
                    f"{name}_real y[{portable.outputs}];", f"unsigned char there[{portable.outputs}];"]  # fmt: skip
            beside = [
                "/* Calls kept until what is late has arrived: define it larger where predict is called more often. */",
                f"#ifndef {self.upper}_KEPT", f"#define {self.upper}_KEPT {portable.late.kept}", "#endif",
                f"struct {name}_kept {{", *(f"    {one}" for one in kept), "};", "",
            ]  # fmt: skip
            fields += [f"struct {name}_kept kept[{self.upper}_KEPT];", "int count;", "unsigned long tickets;"]
        if portable.compares:
            count = len(portable.compares)
            fields += [f"{name}_real before[{len(portable.states)}], sent[{count}];", f"unsigned char known[{count}];"]
        guard = f"{self.upper}_H"
        lines = [
            *self.comment(_usage(portable)), f"#ifndef {guard}", f"#define {guard}", "", "#ifdef __cplusplus",
            'extern "C" {', "#endif", "", f"typedef {self.real} {name}_real;", "", *beside,
            "/* The longest step of the integration: less accurate and quicker where you define it larger. */",
            f"#ifndef {self.upper}_STEP", f"#define {self.upper}_STEP {self.constant(self.about.step)}", "#endif", "",
            "/* Nothing in it is for users. */",
            "typedef struct {", *(f"    {one}" for one in fields), f"}} {name}_state;", "",
        ]  # fmt: skip
        for told, declared in self.declarations():
            lines += [f"/* {_plain(told)} */", f"{declared};"]
        return "\n".join([*lines, "", "#ifdef __cplusplus", "}", "#endif", "", "#endif", ""])

    def _function(
        self, name: str, rows: Iterable[Expression], places: Mapping[str, str], *, u: bool = True, y: bool = False
    ) -> str:
        arguments = ["const real *x", *(["const real *u"] if u else []), *(["const real *y"] if y else [])]
        text = c_function(name, ", ".join(arguments), list(rows), places, self.real)
        return text.replace(f"{self.real} ", "real ")

    def _jump(self, name: str, rows: Iterable[Expression], outputs: Sequence[int]) -> str:
        there = {f"y.{output}": f"y[{k}]" for k, output in enumerate(outputs)}
        return self._function(name, rows, self.at_xu | there, y=True)

    def source(self) -> str:
        """The .c file."""
        portable, name = self.portable, self.name
        parts = [self._function("flow", portable.flow, self.at_xu)]
        weights = [self.constant(float(value)) for row in TABLEAU["A"][: STAGES + 1] for value in row]
        table = "\n        " + ",\n        ".join(", ".join(weights[k : k + 4]) for k in range(0, len(weights), 4))
        parts.append(_STEP.replace("{A}", f"{{{table}}}"))
        if portable.schedule is not None:
            parts += [self._schedule_tables(portable.schedule), _SCHEDULE]
        if portable.late is not None:
            parts.append(self._late_functions())
        else:
            for number_, one in enumerate(portable.corrections):
                parts += [self._jump(f"jump_{number_}_{k}", jump, one.outputs) for k, jump in enumerate(one.jumps)]
        start = {f"initial.{one}": f"x[{i}]" for i, one in enumerate(portable.plant_states)}
        start |= {f"lower.{one}": f"x[{i}]" for i, one in enumerate(portable.plant_states)}
        if portable.starts_from_box:
            start |= {f"upper.{one}": f"y[{i}]" for i, one in enumerate(portable.plant_states)}
        parts.append(self._function("start", portable.start, start, u=False, y=portable.starts_from_box))
        seen = dict(portable.estimates)
        seen |= {"original": tuple(portable.original.values())} if portable.original else {}
        seen |= {"control": tuple(portable.control.values())} if portable.control else {}
        seen |= {"wants_sample": (portable.trigger,)} if portable.trigger is not None else {}
        seen |= {f"stops_{k + 1}": (row,) for k, (row, _) in enumerate(portable.stops)}
        parts += [self._function(f"at_{one}", rows, self.at_x, u=False) for one, rows in seen.items()]
        for word, output, row in portable.compares:
            there = self.at_xu | {f"y.{output}": "y[0]"}
            parts.append(self._function(f"at_sends_{word}", (row,), there, y=True))
        if portable.compares:
            words = [word for word, *_ in portable.compares]
            parts.append(_chosen("excess", [f"at_sends_{word}" for word in words]))
            parts += [_chosen("message", [f"jump_{k}_0" for k in range(len(words))]), _SETTLE]
        bodies = [
            f"{declared}\n{{\n{body}}}\n"
            for (_, declared), body in zip(self.declarations(), self._bodies(), strict=True)
        ]
        code = "\n".join([*parts, *bodies])
        sizes: dict[str, Any] = {"SIZE": len(portable.states), "STAGES": STAGES, "OUTPUTS": portable.outputs}
        sizes |= {"LONGEST": f"{self.upper}_STEP", "NEARLY_ONE": self.constant(1 - 1e-6)}
        sizes |= {"SENDERS": len(portable.compares)} if portable.compares else {}
        sizes |= {"KEPT": f"{self.upper}_KEPT"} if portable.late is not None else {}
        head = [
            *self.comment(),
            f'#include "{name}.h"',
            "",
            "#include <string.h>",
            prelude(code, self.real).rstrip(),
            "",
        ]
        defines = [f"#define {one} {value}" for one, value in sizes.items()]
        text = "\n".join([*head, f"typedef {name}_real real;", *defines, "", code])
        return text.replace("struct state *", f"{name}_state *").replace("struct kept ", f"struct {name}_kept ")

    def _schedule_tables(self, schedule: Schedule) -> str:
        c, count = self.constant, max(1, schedule.count)
        steps = ", ".join(
            f"{{{one.source}, {one.target}, {-1 if one.correction is None else one.correction}, {one.jump}, "
            f"{c(one.low)}, {c(one.high)}}}" for one in schedule.steps
        )  # fmt: skip
        every = [[*own] or [(0.0, 0.0)] for own in schedule.ages]
        ages = ", ".join("{" + ", ".join(f"{{{c(low)}, {c(high)}}}" for low, high in own) + "}" for own in every)
        reads = ", ".join("{" + ", ".join(str(int(k in own)) for k in range(count)) + "}" for own in schedule.sensors)
        node, correction, jump = schedule.start
        defines = {
            "STEPS": len(schedule.steps), "AGES": schedule.count, "START_NODE": node, "START_READS": correction,
            "START_JUMP": jump, "BASE": c(schedule.base), "SHORTEST": c(min(schedule.lengths)), "SLACK": c(1e-3),
            "ELSEWHERE": c(1e30),
        }  # fmt: skip
        return "\n".join([
            *(f"#define {name} {value}" for name, value in defines.items()), "",
            "/* Which gain is used when; times in the shortest period of the sensors; reads -1: nothing arrives. */",
            f"static const struct {{ int from, to, reads, jump; real low, high; }} steps[STEPS] = {{\n    {steps}}};",
            f"static const real ages[{len(schedule.ages)}][{count}][2] = {{{ages}}};",
            f"static const int reads[{len(schedule.sensors)}][{count}] = {{{reads}}};", "",
        ])  # fmt: skip

    def _late_functions(self) -> str:
        late = self.portable.late
        assert late is not None
        every = range(self.portable.outputs)
        parts = [self._function("expected", late.expected, self.at_xu)]
        parts += [self._jump(f"sample_{k}", jump, every) for k, jump in enumerate(late.samples)]
        parts.append(_chosen("sampled", [f"sample_{k}" for k in range(len(late.samples))]))
        return "\n".join([*parts, _LATE])

    def _bodies(self) -> Iterator[str]:
        """Of each public function, in the order of the declarations."""
        portable = self.portable
        schedule, late = portable.schedule, portable.late
        u = "u" if portable.inputs else "0"
        begin = "    memset(s, 0, sizeof *s);\n" + ("    s->node = -1;\n" if schedule is not None else "")
        yield begin + (
            "    start(lower, upper, s->x);\n" if portable.starts_from_box else "    start(estimate, s->x);\n"
        )
        yield "".join(self._predict())
        if late is not None:
            copied = f"    memcpy(one->u, u, {len(portable.inputs)} * sizeof *u);\n" if portable.inputs else ""
            yield (
                f"    struct kept *one = keep(s);\n    one->ticket = s->tickets++;\n"
                f"    one->pattern = (int)(one->ticket % {len(late.samples)});\n{copied}"
                f"    memcpy(one->x, s->x, sizeof one->x);\n    return one->ticket;\n"
            )
            for _, outputs in late.sensors:
                own = ", ".join(map(str, outputs))
                yield (
                    f"    static const int outputs[] = {{{own}}};\n"
                    f"    return arrive(s, ticket, outputs, {len(outputs)}, y);\n"
                )
        for number_, one in enumerate(() if late is not None else portable.corrections):
            yield "".join(self._correct(number_, one, u))
        for estimate in portable.estimates:
            yield f"    at_{estimate}(s->x, out);\n"
        if portable.original:
            yield "    at_original(s->x, out);\n"
        if portable.control:
            yield "    at_control(s->x, out);\n"
        if portable.trigger is not None:
            yield "    real value;\n    at_wants_sample(s->x, &value);\n    return value >= 0;\n"
        for word, *_ in portable.compares:
            yield f"    real value;\n    at_sends_{word}(s->x, {u}, &y, &value);\n    return value >= 0;\n"
        for k in range(len(portable.stops)):
            yield f"    real value;\n    at_stops_{k + 1}(s->x, &value);\n    return value <= 0;\n"

    def _predict(self) -> Iterator[str]:
        portable, inputs = self.portable, len(self.portable.inputs)
        yield "    struct kept *one;\n" if portable.late is not None else ""
        yield "    int i;\n" if portable.schedule is not None and portable.schedule.count else ""
        yield "    if (!(dt > 0))\n        return;\n"
        if portable.late is not None:
            yield "    one = keep(s);\n    one->pattern = -1;\n    one->dt = dt;\n"
            yield f"    memcpy(one->u, u, {inputs} * sizeof *u);\n" if inputs else ""
        if portable.compares:
            yield "    memset(s->known, 0, sizeof s->known);\n"
        if portable.schedule is not None:
            yield "    s->clock += dt / BASE;\n"
            if portable.schedule.count:
                yield "    for (i = 0; i < AGES; i++)\n        s->age[i] += dt / BASE;\n"
        yield f"    flown(s->x, dt, {'u' if inputs else '0'});\n"

    def _correct(self, number_: int, one: Correction, u: str) -> Iterator[str]:
        if self.portable.compares:
            yield f"    settled(s, {number_}, *y, {u});\n"
            return
        yield "    real after[SIZE];\n"
        if self.portable.schedule is None:
            yield f"    jump_{number_}_0(s->x, {u}, y, after);\n    memcpy(s->x, after, sizeof after);\n"
            return
        cases = "".join(
            f"    case {k}: jump_{number_}_{k}(s->x, {u}, y, after); break;\n" for k in range(1, len(one.jumps))
        )
        yield f"    int known;\n    switch (next(s, {number_}, &known)) {{\n{cases}"
        yield f"    default: jump_{number_}_0(s->x, {u}, y, after); break;\n    }}\n"
        yield "    memcpy(s->x, after, sizeof after);\n    return known;\n"


def _chosen(name: str, functions: Sequence[str]) -> str:
    """A function that calls the one of a number."""
    arguments = "int which, const real *x, const real *u, const real *y, real *out"
    cases = [f"    case {k}: {one}(x, u, y, out); break;" for k, one in enumerate(functions)]
    return "\n".join([f"static void {name}({arguments})", "{", "    switch (which) {", *cases, "    }", "}", ""])


def _usage(portable: Portable) -> list[str]:
    first = "the first sample is at t = 0" if portable.first_sample else "the sample at t = 0 is not used"
    word = f"{portable.name}_"
    told = [f"Use: {word}init once; {first}."]
    if portable.late is not None:
        told.append(
            f"At each instant at which the sensors are read call {word}sample, and {word}arrive.. as values come."
        )
    elif portable.trigger is not None:
        told.append(f"Call {word}predict in short steps; as soon as {word}wants_sample, measure and {word}correct.")
    elif portable.compares:
        told.append(f"A sensor with a copy of the observer sends when {word}sends..; then both call {word}correct...")
    else:
        told.append(f"At each sample {word}correct.., and {word}predict from one to the next, in one step or several.")
    return [*told, "Nothing is allocated, and there is no global state: any number of observers run side by side."]


def _listed(outputs: Sequence[int]) -> str:
    return ("outputs " if len(outputs) > 1 else "output ") + ", ".join(str(k + 1) for k in outputs)


def tail(suffix: str) -> str:
    """Behind the name of a function."""
    return f"_{suffix}" if suffix else ""


def _plain(line: str) -> str:
    """Text that ends no comment of C, begins none, and holds no trigraph."""
    for mark in ("*/", "/*", "??"):
        while mark in line:
            line = line.replace(mark, f"{mark[0]} {mark[1]}")
    return line
