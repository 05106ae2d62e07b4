"""The test program of an exported observer in C: calls of a simulated run, replayed and compared; and its Makefile."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from cdobs_cli.codegen import DOUBLE
from cdobs_cli.export.about import About
from cdobs_cli.export.c99 import C99, tail
from cdobs_cli.export.portable import Portable
from cdobs_cli.export.vectors import Vectors, allowed

KINDS = ("predict", "correct", "sample", "arrive", "asks")
_OF_SINGLE = 1e-4  # what single precision is compared to, in parts of the size of an estimate


def c99_files(portable: Portable, about: About, told: Vectors | None, real: str = DOUBLE) -> dict[str, str]:
    """The files by name. real: `double` or `float`."""
    writer = C99(portable, about, real)
    files = {f"{portable.name}.h": writer.header(), f"{portable.name}.c": writer.source()}
    if told is not None:
        test = _Test(writer).text(told)
        files |= {f"{portable.name}_test.c": test, "Makefile": _MAKEFILE.format(name=portable.name)}
    return files


_MAKEFILE = """\
# `make` compiles the observer and its test, runs it with and without sanitizers, and prints the size of the code.
CC ?= cc
CFLAGS = -std=c99 -pedantic -Wall -Wextra -Werror -O2

test: {name}_test {name}_checked
\t./{name}_checked
\t./{name}_test
\tsize {name}.o

{name}.o: {name}.c {name}.h
\t$(CC) $(CFLAGS) -c -o $@ {name}.c

{name}_test: {name}_test.c {name}.o
\t$(CC) $(CFLAGS) -o $@ {name}_test.c {name}.o -lm

{name}_checked: {name}_test.c {name}.c {name}.h
\t$(CC) $(CFLAGS) -g -fsanitize=address,undefined -fno-sanitize-recover -o $@ {name}_test.c {name}.c -lm

clean:
\trm -f {name}.o {name}_test {name}_checked

.PHONY: test clean
"""


class _Test:
    def __init__(self, writer: C99) -> None:
        self.writer, self.portable, self.about = writer, writer.portable, writer.about
        self.name, self.real, self.constant = writer.name, writer.real, writer.constant
        self.begin = "start, start + N" if self.portable.starts_from_box else "start"

    def text(self, told: Vectors) -> str:
        portable, name, c = self.portable, self.name, self.constant
        m, p, rows, n = len(portable.inputs), portable.outputs, len(portable.rows), len(portable.plant_states)
        controls = len(portable.control)

        def braced(values: Sequence[float], size: int) -> str:
            return "{" + (", ".join(map(c, values)) or "0") + "}" if size else "{0}"

        calls = ",\n    ".join(
            f"{{{KINDS.index(one.kind)}, {one.which}, {one.ticket}, {int(bool(one.expected))}, {c(one.dt)}, "
            f"{braced(one.u, m)}, {braced(one.y, p)}, {braced(one.expected, rows)}, {braced(one.control, controls)}}}"
            for one in told.calls
        )
        scale = ", ".join(map(c, told.scale))
        places = {
            "real": f"{name}_real", "NAME": name, "M": max(1, m), "P": p, "ROWS": rows, "N": n,
            "CONTROLS": max(1, controls), "INIT": self.begin,
            "CALLS": calls, "SCALE": scale, "START": ", ".join(map(c, told.start)),
            "TOLERANCE": repr(self._tolerance()),
            "CASES": "\n".join(self._cases()), "SEE": "\n".join(
                f"    {name}_{one}(s, got + {k * n});" for k, one in enumerate(portable.estimates)),
            "TIMED": "\n".join(self._timed()), "COMMENT": "\n".join(self.writer.comment()),
        }  # fmt: skip
        text = _TEST
        for word, value in places.items():
            text = text.replace(f"@{word}@", str(value))
        return text

    def _tolerance(self) -> float:
        if self.real != DOUBLE:
            return _OF_SINGLE
        return allowed(self.about.accuracy)

    def _cases(self) -> Iterator[str]:
        portable, name = self.portable, self.name
        u = ", one->u" if portable.inputs else ""
        yield f"        case 0: {name}_predict(&s, one->dt{u}); break;"
        if portable.late is not None:
            yield f"        case 2: wrong |= {name}_sample(&s{u}) != (unsigned long)one->ticket; break;"
            yield "        case 3:"
            for k, (word, _) in enumerate(portable.late.sensors):
                call = f"{name}_arrive{tail(word)}(&s, (unsigned long)one->ticket, one->y)"
                yield f"            if (one->which == {k}) wrong |= !{call};"
            yield "            break;"
        else:
            yield "        case 1:"
            for k, one in enumerate(portable.corrections):
                call = f"{name}_correct{tail(one.suffix)}(&s, one->y{u});"
                answer = "wrong |= !" if portable.schedule is not None else ""
                yield f"            if (one->which == {k}) {answer}{call}"
            if portable.control:
                yield f"            {name}_control(&s, control);"
                yield f"            for (j = 0; one->seen && j < {len(portable.control)}; j++)"
                yield "                note(fabs((double)(control[j] - one->control[j])), 1.0, &worst);"
            yield "            break;"
        if portable.trigger is not None:
            yield f"        case 4: ahead = s; {name}_predict(&ahead, one->dt{u});"
            yield f"            wrong |= {name}_wants_sample(&ahead) != one->which; break;"

    def _timed(self) -> Iterator[str]:
        """What is run again and again for the time that a call takes."""
        u = ", calls[i].u" if self.portable.inputs else ""
        runs = [("predict", "calls[i].kind == 0", f"{self.name}_predict(&s, calls[i].dt{u});")]
        if self.portable.late is None:
            one = f"{self.name}_correct{tail(self.portable.corrections[0].suffix)}"
            runs.append(("correct", "calls[i].kind == 1 && calls[i].which == 0", f"{one}(&s, calls[i].y{u});"))
        for what, condition, call in runs:
            yield f"    for (done = 0, i = 0; i < COUNT; i++) done += {condition};"
            yield "    for (begin = clock(), round = 0; done && round < ROUNDS; round++) {"
            yield f"        {self.name}_init(&s, {self.begin});"
            yield f"        for (i = 0; i < COUNT; i++) if ({condition}) {call}"
            yield "    }"
            yield f'    if (done) printf("{what}: %.3g us on this machine\\n", 1e6 * seconds(begin) / ROUNDS / done);'


_TEST = """\
@COMMENT@
/* Calls of a simulated run, and what the estimate was after each. */
#include "@NAME@.h"

#include <float.h>
#include <math.h>
#include <stdio.h>
#include <time.h>

typedef @real@ real;
enum { N = @N@, ROWS = @ROWS@, ROUNDS = 200 };

/* kind 0: predict, 1: correct, 2: sample, 3: arrive, 4: whether a sample is due dt later. */
struct call {
    int kind, which, ticket, seen;
    real dt, u[@M@], y[@P@], expected[ROWS], control[@CONTROLS@];
};
static const struct call calls[] = {
    @CALLS@
};
enum { COUNT = sizeof calls / sizeof calls[0] };
static const real scale[ROWS] = {@SCALE@};
static const real start[] = {@START@};

static void note(double distance, double size, double *worst)
{
    double part = distance / size;
    if (!(part <= *worst))
        *worst = part == part ? part : DBL_MAX;
}

static double seconds(clock_t begin)
{
    return (double)(clock() - begin) / CLOCKS_PER_SEC;
}

static void see(const @NAME@_state *s, real *got)
{
@SEE@
}

int main(void)
{
    @NAME@_state s, ahead;
    real got[ROWS], control[@CONTROLS@];
    double worst = 0.0;
    int i, j, wrong = 0, round, done;
    clock_t begin;
    (void)ahead; (void)control; (void)round; (void)done; (void)begin;
    @NAME@_init(&s, @INIT@);
    for (i = 0; i < COUNT; i++) {
        const struct call *one = &calls[i];
        switch (one->kind) {
@CASES@
        default: break;
        }
        if (one->seen) {
            see(&s, got);
            for (j = 0; j < ROWS; j++)
                note(fabs((double)(got[j] - one->expected[j])), (double)scale[j], &worst);
        }
    }
@TIMED@
    printf("state: %lu bytes\\n", (unsigned long)sizeof s);
    printf("largest distance from the simulation: %.3g of at most %.3g, in parts of its size\\n", worst, @TOLERANCE@);
    if (wrong)
        printf("a call was not answered as it should be\\n");
    return wrong || !(worst <= @TOLERANCE@);
}
"""
