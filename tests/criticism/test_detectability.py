"""The smallest detectable size is that at which an effect gets named in four of five campaigns.

Residuals are drawn from the linear model of `test_evidence`: no refit.
"""

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from test_evidence import CHANNELS, EFFECTS, LARGEST, RATE, ROWS, RUNS, drawn, problem
from test_one_number import made

from imubayes.criticism import detectability
from imubayes.criticism.detectability import RUN_OFFSETS, AbsorbedResponses
from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf, Hypothesis
from imubayes.criticism.explanation_records import NAMED
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.parameters.declarations import Priors
from imubayes.parameters.priors import Normal

FIELDS = {"gyro_bias": "bias", "gyro_scale_factor": "scale"}
OWN = [
    SimpleNamespace(name=f"{effect}.{field}[{channel}]", effect=effect, field=field, factor=1.0, shown_unit="1")
    for channel in CHANNELS
    for effect, field in FIELDS.items()
]
SCATTER = ((0.0, math.log(0.5)), (0.8, math.log(0.5)))


@pytest.fixture(autouse=True)
def _nothing_is_stated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(detectability, "stated_size", lambda *_: None)


def absorbed(scatter: tuple[tuple[float, float], ...] = ()) -> AbsorbedResponses:
    """Return what the model of `test_evidence` absorbs."""
    priors = Priors.stack([Normal(0.0, 1.0)] * len(OWN))
    layout = SimpleNamespace(parameters=OWN, names=[each.name for each in OWN])
    model = made(Model, layout=layout, problem=SimpleNamespace(priors=priors))
    fit: Any = made(Fit, model=model, z=np.zeros(len(OWN)))
    return AbsorbedResponses(EvidenceOf(problem(np.zeros((2, RUNS * ROWS)), scatter)), fit)


def log_odds(residual: np.ndarray, effect: str) -> float:
    """Return the log odds for one effect, in any form, against nothing missing."""
    of = EvidenceOf(problem(residual))
    none = of.evaluate(Hypothesis((), of.stated))
    mine = [n for n, each in enumerate(of.variants) if each.effect == effect]
    found = [of.evaluate(Hypothesis((n,), of.stated), none).log_posterior for n in mine]
    return float(np.logaddexp.reduce(found) - none.log_posterior)


@pytest.mark.parametrize(
    "effect",
    ["scale_cubic", *(pytest.param(one, marks=pytest.mark.slow) for one in ("scale_asymmetry", "bias_temperature"))],
)
@pytest.mark.slow
def test_at_the_smallest_detectable_size_four_of_five_are_named(effect: str) -> None:
    seen = next(each for each in absorbed().of_effects if each.effect == effect)
    assert not seen.undetectable
    size, count = seen.smallest_detectable, 60

    def share(times: float) -> float:
        drawings = (drawn(seed, {(effect, 0): times * size}) for seed in range(500, 500 + count))
        return float(np.mean([log_odds(one, effect) >= math.log(NAMED / (1 - NAMED)) for one in drawings]))

    assert 0.6 < share(1.0) < 0.95
    # Half of it is missed as often, and twice of it never.
    assert share(0.5) < 0.35
    assert share(2.0) == 1


def test_what_is_left_of_a_response_is_that_of_least_squares() -> None:
    found = absorbed()
    names = list(EFFECTS)
    columns = np.column_stack([3.0 * np.ones_like(RATE), 50 * RATE])
    own = np.linalg.inv(columns.T @ columns + np.eye(2))
    for k, effect in enumerate(names):
        response = LARGEST * EFFECTS[effect]
        across = columns.T @ response
        assert found.raw[2 * k] == pytest.approx(response @ response)
        assert found.left[2 * k] == pytest.approx(response @ response - across @ own @ across, rel=1e-6)
        assert found.shift[:2, 2 * k] == pytest.approx(own @ across)


def test_absorbers_and_bias_are_told_of_what_looks_like_a_parameter() -> None:
    """A cube of the rate is mostly a scale factor; squares are mostly a bias."""
    by_name = {each.effect: each for each in absorbed().of_effects}
    cubic = by_name["scale_cubic"]
    assert cubic.absorbed_by[0].parameter == "gyro_scale_factor.scale"
    assert cubic.absorbed_by[0].share == pytest.approx(1 - cubic.retained, abs=0.05)
    assert cubic.bias is not None
    assert cubic.bias.parameter.startswith("gyro_scale_factor.scale")
    # In units of z a slope of 1: the least squares line of RATE³, over 50.
    line = LARGEST * float(RATE**3 @ RATE / (RATE @ RATE)) / 50
    assert abs(cubic.bias.value) == pytest.approx(line, rel=0.02)
    assert by_name["scale_asymmetry"].absorbed_by[0].parameter == "gyro_bias.bias"


def test_offsets_of_runs_absorb_what_acts_between_runs() -> None:
    """The scatter that the prior allows hides part of a bias over temperature, and none of an asymmetry."""
    plain, mixed = ({each.effect: each for each in absorbed(one).of_effects} for one in ((), SCATTER[1:]))
    between = "bias_temperature"
    assert mixed[between].smallest_detectable > 1.5 * plain[between].smallest_detectable
    assert RUN_OFFSETS in {each.parameter for each in mixed[between].absorbed_by}
    within = "scale_temperature"
    assert mixed[within].smallest_detectable == pytest.approx(plain[within].smallest_detectable, rel=0.05)
