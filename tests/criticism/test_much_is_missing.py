"""A model that lacks a great deal: its first effects are named together, and neither noise nor structure is judged yet.

What is planted is worked out here, without the package's effects.
"""

import numpy as np
from null_data import fitted_to, redrawn
from test_chain_stage import signal

from imubayes.criticism import stepwise_search, thresholds
from imubayes.criticism.diagnose import judge
from imubayes.display.diagnosis_report import next_command
from imubayes.display.diagnosis_sentences import sentence
from imubayes.inference.fitted_model import Fit

# Sizes over the noise of a row of the curve that each channel gets, at the largest input: one effect each.
CURVES = {"gx": 3e4, "gy": 1e4, "gz": 3e3, "ax": 1e3, "ay": 3e2, "az": 1e2}
PLANTED = {
    "gyro_scale_asymmetry", "gyro_scale_quadratic", "gyro_scale_cubic", "accel_quadratic", "accel_cubic",
    "accel_scale_asymmetry", "converter_nonlinearity",
}  # fmt: skip
"""The last one is a square and a cube, on all channels of a kind."""


def curved(fitted: Fit) -> Fit:
    """Return a fit to fresh data, every channel with another curve of its input."""
    entries, channels, x = fitted.model.entries, fitted.model.campaign.channels, signal(fitted)
    change = np.zeros(len(entries))
    shapes = (np.abs, np.square, lambda u: u**3, np.square, lambda u: u**3, np.abs)
    for place, (channel, shape) in enumerate(zip(channels, shapes, strict=True)):
        here = (entries.channel == place) & ~entries.closing
        u = x[here] / np.abs(x[here]).max()
        change[here] = CURVES[channel.name] * channel.noise / 10 * shape(u)
    return redrawn(fitted, 3, change=change)


def test_the_first_effects_are_named_together(monkeypatch):
    planted = curved(fitted_to("hidden-none"))
    found = judge(planted)
    assert found.unfinished
    assert found.verdict == "equivalent_effects"
    named = [group.effects for group in found.groups]
    assert all(set(effects) & PLANTED for effects in named), named
    assert len(named) >= 2
    assert not [each for each in found.noise if each.adopted]
    assert found.suggested is not None
    leaders = tuple(dict.fromkeys(effects[0] for effects in named))
    assert found.suggested.effects[: len(leaders)] == leaders
    assert set(found.suggested.effects) == {effect for effects in named for effect in effects}
    assert "The model lacks more: add what is named and diagnose again." in sentence(found)
    assert next_command(found).startswith(f"imubayes add {named[0][0]} ")
    # Planted fault: no effect counts as dominant, and what is missing passes for noise and structure.
    monkeypatch.setattr(thresholds, "LESS_NOISE", 0.0)
    misled = stepwise_search.search(planted)
    assert not misled.unfinished
    assert misled.adopted
