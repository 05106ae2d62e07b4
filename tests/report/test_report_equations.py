"""Formulas: what is printed in LaTeX and MathML for typed expressions."""

from xml.etree import ElementTree

import pytest

from cdobs_cli.exact.expression import Variable
from cdobs_cli.exact.numbers import ExactMatrix
from cdobs_cli.exact.parser import parse
from cdobs_cli.report.equations import Equation, formula, latex, latex_block, mathml, mathml_block, matrix, name_formula
from cdobs_cli.report.systems import cancelled, dotted

NAMES = frozenset({"theta", "omega", "x1", "x_2", "S", "X", "glucose", "u"})


@pytest.mark.parametrize(
    ("typed", "printed"),
    [
        ("sin(theta)", r"\sin \left( \theta \right)"),
        ("-9.81*sin(theta)/2", r"- \frac{9.81 \sin \left( \theta \right)}{2}"),
        ("x1 - (x_2 + u)", r"x_{1} - \left( x_{2} + u \right)"),
        ("x1**2*x_2", r"x_{1}^{2} x_{2}"),
        ("sin(theta)**2", r"\sin^{2} \left( \theta \right)"),
        ("(x1 + 1)**3", r"\left( x_{1} + 1 \right)^{3}"),
        ("theta**(1/2)", r"\sqrt{\theta}"),
        ("x1**(-1)", r"x_{1}^{- 1}"),
        ("monod(S, 0.5)", r"\frac{S}{0.5 + S}"),
        ("contois(S, X, 2)", r"\frac{S}{2 X + S}"),
        ("contois(S, X, 1)", r"\frac{S}{X + S}"),
        ("atan(x1)**2*log10(S)", r"\arctan^{2} \left( x_{1} \right) \log_{10} \left( S \right)"),
        ("u**1.852", r"u^{1.852}"),
        ("exp(-u)", r"e^{- u}"),
        ("abs(u)", r"\left| u \right|"),
        ("sat(u)", r"\mathrm{sat}_{\left[ - 1 , 1 \right]} \left( u \right)"),
        ("glucose/3", r"\frac{\mathrm{glucose}}{3}"),
        ("theta*(1/3)", r"\theta \cdot \frac{1}{3}"),
        ("2*pi*u", r"2 \pi u"),
    ],
)
def test_latex(typed: str, printed: str) -> None:
    assert latex(formula(parse(typed, NAMES))) == printed


def test_names() -> None:
    assert latex(name_formula("hat.theta")) == r"\hat{\theta}"
    assert latex(name_formula("hat.x1")) == r"\hat{x}_{1}"
    assert latex(name_formula("d.0")) == "d_{1}"
    assert latex(name_formula("lower.S")) == r"\underline{S}"
    assert latex(name_formula("z_lower.0")) == r"\underline{z}_{1}"
    assert latex(name_formula("x_1.2")) == r"x_{1 , 3}"
    assert "θ" in mathml(name_formula("theta"))


def test_long_numbers_are_cut_in_formulas_and_whole_in_gains() -> None:
    assert latex(formula(parse("1.41421356237309504*u", NAMES))) == "1.41421356237309504 u"
    assert latex(formula(parse("1.4142135623730950488016887242*u", NAMES))) == r"1.414213562373095\dots u"
    assert (
        latex(matrix(ExactMatrix([["1.41421356237309504"]])))
        == r"\left[ \begin{matrix} 1.41421356237309504 \end{matrix} \right]"
    )


@pytest.mark.parametrize(
    "typed", ["sin(theta)**2/(1 + x1)", "sat(u, -2, 2)", "min(x1, sqrt(S))", "tan(u) - 1e-30*S", "glucose**(2/3)"]
)
def test_mathml_is_well_formed(typed: str) -> None:
    ElementTree.fromstring(mathml_block([Equation(name_formula("lower.x1"), formula(parse(typed, NAMES)))]))


def test_a_formula_too_long_to_read_is_named_by_its_size() -> None:
    shared = Variable("u")
    for _ in range(200):
        shared = shared * (shared + Variable("S"))
    assert "terms" in latex(formula(shared))
    assert len(latex_block([Equation(name_formula("u"), formula(shared))])) < 300


def test_derivatives_of_words_and_letters() -> None:
    assert latex(dotted(name_formula("x1"))) == r"\dot{x}_{1}"
    assert latex(dotted(name_formula("glucose"))) == r"\frac{d}{d t} \mathrm{glucose}"


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("x1 + (u - x1)", "u"),
        ("x1 + 2*(u - 0.5*x1)", "2 u"),
        ("x1 - x1", "0"),
        ("x1 + 0.5*(u - x1)", None),
        ("sin(x1 - x1 + u)", None),
    ],
)
def test_what_cancels_is_left_out_and_the_rest_stays(text: str, shown: str | None) -> None:
    typed = parse(text, NAMES)
    assert latex(formula(cancelled(typed))) == (latex(formula(typed)) if shown is None else shown)
