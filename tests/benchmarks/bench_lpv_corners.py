"""Chains of n integrators whose last row varies with every state: all 2^n corners, searched and proved.

    python tests/benchmarks/bench_lpv_corners.py [largest n] [--verbs]

Prints, for each n: the period, seconds of processor time for the gain (convex synthesis), for the certificate of the
rounded gain, for its proof in balls at all 2^n corners; with --verbs also seconds of `synthesize` and `certify`, and
the verdict.
"""

from __future__ import annotations

import sys
import time

import rooms  # noqa: F401 - opens the folders
from table import row

from cdobs_cli.certify.methods.wirtinger.certificate import Wirtinger
from cdobs_cli.certify.methods.wirtinger.design import HeldSynthesis
from cdobs_cli.exact.numbers import Exact, ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.families.lpv_zoh import LpvZeroOrderHold
from cdobs_cli.plant import Plant, Slopes
from cdobs_cli.sampling import SamplingLaw

PERIODS = {2: "0.5", 3: "0.3", 4: "0.2", 5: "0.1", 6: "0.1", 7: "0.05", 8: "0.05"}


def chain(n: int, T: str) -> Plant:
    """xdot_i = x_(i+1), xdot_n = 0.1 (sin x_1 + .. + sin x_n), y = x_1, any T_k <= T."""
    names = tuple(f"x{i + 1}" for i in range(n))
    A = ExactMatrix([[int(j == i + 1) for j in range(n)] for i in range(n)])
    upper = ExactMatrix([["0.1" if i == n - 1 else 0 for _ in range(n)] for i in range(n)])
    lower = ExactMatrix([[-entry for entry in row] for row in upper.rows])
    last = parse("0.1*(" + " + ".join(f"sin({name})" for name in names) + ")", frozenset(names))
    phi = (*(parse("0") for _ in range(n - 1)), last)
    C = ExactMatrix([[int(j == 0) for j in range(n)]])
    return Plant(names, (), A, phi, None, C, Slopes(lower, upper), SamplingLaw("aperiodic", Exact(0), Exact(T)))


def main() -> None:
    largest = next((int(argument) for argument in sys.argv[1:] if argument.isdigit()), 8)
    print(f"{'n':>2} {'corners':>7} {'period':>6} {'gain s':>8} {'search s':>8} {'proof s':>8}  outcome")
    spent = {}
    for n, T in PERIODS.items():
        if n > largest:
            break
        plant = chain(n, T)
        start = time.process_time()
        found = HeldSynthesis(plant).propose(float(T), 0.0)
        gained = time.process_time()
        question = LpvZeroOrderHold().question(plant, {"L": ExactMatrix.from_floats(found.L, 6)}, 1)
        certificate = Wirtinger.propose(question)
        searched = time.process_time()
        proved = certificate is not None and certificate.prove(question).holds
        ended = time.process_time()
        spent[n] = ended - start
        outcome = "proved" if proved else "undecided"
        seconds = f"{gained - start:>8.3f} {searched - gained:>8.3f} {ended - searched:>8.3f}"
        print(f"{n:>2} {2**n:>7} {T:>6} {seconds}  {outcome}", flush=True)
        if "--verbs" in sys.argv:
            card = LpvZeroOrderHold()
            start = time.process_time()
            design = card.synthesize(plant, 1)
            made = time.process_time()
            check = card.certify(plant, design, 1)
            bracket = check.bounds.get("period_max")
            ends = (bracket.proved, bracket.refuted) if bracket else None
            seconds = f"synthesize {made - start:.1f} s, certify {time.process_time() - made:.1f} s"
            print(f"   {seconds}: {design.outcome}, {check.verdict}, period in {ends}", flush=True)
    if largest in spent and largest - 1 in spent:
        # Twice the corners, each a little larger.
        names = f"all corners, n = {largest} / n = {largest - 1}"
        row(names, spent[largest], spent[largest - 1], 3)


if __name__ == "__main__":
    main()
