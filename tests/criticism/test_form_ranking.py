"""Which form is evaluated first: the quick gains of forms rank them as their evidence does."""

import numpy as np
import pytest
from test_evidence import RATE, drawn, problem

from imubayes.criticism.evidence import model_search
from imubayes.criticism.evidence.free_forms import ChosenForm, FormColumns, FormHypothesis
from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf, Hypothesis
from imubayes.criticism.evidence.model_search import FormScan
from imubayes.responses.wrong_inputs import NO_RUN, WrongInput

SHAPES = 100 * np.stack([np.cos(n * np.pi * RATE) for n in range(1, 7)], axis=1)
"""Responses to six parameters, (rows, 6), the same on both channels."""
SIZES = 0.004 * np.array([1.8, -1.0, 1.0, -1.0, 1.0, 1.0])
PRIOR = WrongInput(NO_RUN, "prior", parameters=tuple(range(6)))


def too_narrow(count: int, channels: tuple[int, ...]) -> FormHypothesis:
    """Return that the prior of the first parameters is too narrow, as seen by some channels."""
    columns = {k: FormColumns(count, lambda: SHAPES[:, :count]) for k in channels}
    return FormHypothesis("input", f"prior of {count}", (), columns, (6.0, 60.0), wrong=PRIOR, unit=1.0)


def scanned(seed: int) -> FormScan:
    of = EvidenceOf(problem(drawn(seed) + SHAPES @ SIZES))
    at = of.evaluate(Hypothesis((), of.stated))
    return FormScan(of, of.solved(at, np.ones(2)))


def test_a_narrow_prior_that_two_channels_show_comes_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its coefficients are counted once: as if each channel had its own, the largest one alone would rank first.

    Occam's factor of six coefficients on two channels costs more than five of them gain.
    """
    monkeypatch.setattr(model_search, "_AT_ONCE", 1)
    whole, part = too_narrow(6, (0, 1)), too_narrow(1, (0, 1))
    scan = scanned(3)
    (gain, found), *_ = scan.best([part, whole])
    exact = [scan.exact(ChosenForm(whole, amplitude, (0, 1))) for amplitude in whole.amplitudes]
    assert max(exact) > max(scan.exact(ChosenForm(part, amplitude, (0, 1))) for amplitude in part.amplitudes) + 3
    assert found.form is whole
    assert gain == pytest.approx(max(exact))
