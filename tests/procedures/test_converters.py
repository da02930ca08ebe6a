"""One sensor behind each kind of converter: textbook and joint fit find the same drift, whatever the output is."""

from pathlib import Path

import accel_channel
import pytest

from imubayes.api import fit
from imubayes.campaign import load_campaign
from imubayes.procedures.classical import classical
from imubayes.procedures.textbook import Estimate

ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("converter", ["V/F", "ADC"])
def test_drift_of_gain_and_offset_is_found_behind_any_converter(converter, tmp_path):
    truth = accel_channel.generate(tmp_path, 11, converter)
    result = fit(tmp_path, ROOT / "models" / "accel-channel.toml", sample=False)
    assert result.converged
    summary = result.summary.model_dump()
    known = {one["name"]: one for one in (*summary["parameters"], *summary["derived"])}
    drift = [name for name in known if name.startswith(("converter_", "delta_k", "accel_scale"))]
    assert any(name.startswith("delta_k") for name in drift)
    for name in drift:
        one = known[name]
        assert abs(one["mean"] - truth[name]) < 4 * one["sd"], name
    # The textbook's lines stand on the same outputs: seats and source are in them, the decision is not changed.
    lines = {one.name: one for one in classical(load_campaign(tmp_path)) if isinstance(one, Estimate)}
    for name in (one for one in drift if one.startswith("delta_k")):
        assert abs(lines[name].value - truth[name]) < 4 * lines[name].sd, name
