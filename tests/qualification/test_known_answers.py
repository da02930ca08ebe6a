"""`imubayes selftest`: every known answer is reproduced, and a fault of any part is seen."""

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from imubayes.cli.main import run
from imubayes_qualification.evaluation import known_answers
from imubayes_recordings.noise_analysis.allan_deviation import AllanVariance


def wrong(answers) -> list[str]:
    return [answer.subject for answer in answers if not answer.agrees]


@pytest.mark.slow
def test_an_installation_reproduces_the_known_answers(capsys):
    assert run(["selftest", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert {"jax", "numpy", "Python"} <= {each["package"] for each in found["software"]}
    assert len(found["answers"]) >= 15
    fitted = next(each for each in found["answers"] if each["subject"].startswith("joint fit"))
    # The mode is the stated vector, not somewhere within its uncertainty.
    assert fitted["found"] < 1e-8


def test_a_formula_to_first_order_is_told_from_the_models(monkeypatch):
    """An input axis without its norm differs by some parts in ten million of the scale factor."""

    def first_order(axis, theta, inputs):
        norm = np.sqrt(1 + theta[2] ** 2 + theta[3] ** 2)
        bias = axis.kind.scale * (1 + theta[1]) * theta[0]
        return (known(axis, theta, inputs) - bias) * norm + bias

    known = known_answers._Axis.output
    monkeypatch.setattr(known_answers._Axis, "output", first_order)
    assert wrong(known_answers._constructed()) == ["joint fit: largest distance of an estimate from its value, in u"]


def test_a_standard_uncertainty_that_is_too_small_is_seen(monkeypatch):
    fit = known_answers.fit

    def narrow(*given, **options):
        found = fit(*given, **options).fit
        before = found.posterior.points.mean(axis=0)
        points = before + 0.9 * (found.posterior.points - before)
        return SimpleNamespace(fit=replace(found, posterior=replace(found.posterior, points=points)))

    monkeypatch.setattr(known_answers, "fit", narrow)
    assert wrong(known_answers._constructed()) == ["the same: largest relative error of a standard uncertainty"]


def test_an_installation_that_differs_is_refused(monkeypatch, capsys):
    evaluate = known_answers.allan_variance

    def biased(record) -> AllanVariance:
        found = evaluate(record)
        return AllanVariance(found.factor, found.tau, found.variance * 1.001, found.terms, found.phases)

    monkeypatch.setattr(known_answers, "allan_variance", biased)
    monkeypatch.setattr(known_answers, "_PARTS", {"Allan deviation": known_answers._allan_deviations})
    assert run(["selftest"]) == 1
    said = " ".join(capsys.readouterr().out.split())
    assert "3 of 3 values DIFFER" in said


@pytest.mark.parametrize("axis", known_answers._UNIT, ids=lambda axis: axis.name)
def test_the_formula_is_that_of_a_textbook(axis):
    """Output = scale (1 + e)(input along the true input axis + bias), by a rotation of one's own."""
    bias, error, toward_o, toward_s = axis.stated
    inputs = np.random.default_rng(3).standard_normal((5, 3))
    vector = np.roll([1.0, toward_o, toward_s], axis.place)
    expected = axis.kind.scale * (1 + error) * (inputs @ vector / np.linalg.norm(vector) + bias)
    np.testing.assert_allclose(axis.output(np.array(axis.stated), inputs), expected, rtol=1e-14)
