"""Names and signs in sentences and labels: set where they are names, left where they are something else."""

from __future__ import annotations

import re

import pytest

from cdobs_cli.report.prose import html, mathtext, plain


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("-1 <= d phi_2 / d theta <= 1 for theta, omega_m in R", "-1 ≤ ∂φ_2/∂θ ≤ 1 for θ, ω_m in R"),
        ("rho^2 < 1 -> V", "ρ^2 < 1 → V"),
        ("(2 * tanh(2 * omega)**2 - 1)", "(2 · tanh(2 · ω)² - 1)"),
        ("`theta <= 1`, error.theta.reached, specs/theta.yaml", "`theta <= 1`, error.theta.reached, specs/theta.yaml"),
        ("thetas, alphabet, eta-like", "thetas, alphabet, η-like"),
    ],
)
def test_as_characters(text: str, shown: str) -> None:
    assert plain(text) == shown


def test_on_a_page_names_are_formulas() -> None:
    assert html("omega_m < 1") == "<math><msub><mi>ω</mi><mi>m</mi></msub></math> &lt; 1"
    assert html("rho^(2k)") == "<math><msup><mi>ρ</mi><mn>2k</mn></msup></math>"
    assert "<mo>/</mo>" in html("d phi_2 / d theta") and " d " not in html("d phi_2 / d theta")
    assert html("what `check` proves") == "what <code>check</code> proves"


@pytest.mark.parametrize("text", ["<script>", "a 0.66 s, 1e-5, 2e5", "Boukal2020, (24)", "period_max_any_gain", "$100"])
def test_what_is_no_name_stays(text: str) -> None:
    assert "<math>" not in html(text) and "<script" not in html(text)
    assert mathtext(text) == text


def test_hostile_text_is_escaped_between_names() -> None:
    shown = re.sub("<math>.*?</math>", "", html("<b>theta</b> x_1 <i> `<u>`"))
    assert "<" not in shown.replace("<code>", "").replace("</code>", "")


def test_a_label_keeps_its_dollars_and_its_unit() -> None:
    assert mathtext("width of theta (m2/s)") == r"width of $\theta$ (m2/s)"
    assert mathtext(r"error of $\theta$ (rad)") == r"error of $\theta$ (rad)"
