"""The smallest campaign with a model that lacks one effect, fitted once; the loop's tests go on from there."""

from dataclasses import replace
from pathlib import Path

from imubayes.model.model_file import ModelSpec, read_model

ROOT = Path(__file__).parents[2]
CAMPAIGN = ROOT / "data" / "accel-channel"
LACKING = "converter_offset_drift"


def lacking_model() -> ModelSpec:
    """Return the campaign's own model less the drift of the converter's offset."""
    spec = read_model(ROOT / "models" / "accel-channel.toml")
    kept = tuple(one for one in spec.effects if one.name != LACKING)
    assert len(kept) == len(spec.effects) - 1
    return replace(spec, effects=kept)
