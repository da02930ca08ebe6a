"""Errors of tables of several axes and of a centrifuge that a model lacks are named first (`make study`)."""

from dataclasses import replace
from pathlib import Path

import centrifuge
import multi_axis_table
import pytest
import serial_table

from imubayes.api import diagnose
from imubayes.campaign import load_campaign
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model

ROOT = Path(__file__).parents[2]
HIDDEN = (
    ("middle_axis_squareness", multi_axis_table, {"middle_axis_squareness.angle[three-axis]": 15.0}),
    ("outer_axis_squareness", multi_axis_table, {"outer_axis_squareness.angle[three-axis]": -15.0}),
    ("middle_axis_zero", multi_axis_table, {"middle_axis_zero.zero[three-axis]": 20.0}),
    ("outer_axis_intersection", multi_axis_table, {"outer_axis_intersection.distance[three-axis]": 150.0}),
    ("accel_cubic", centrifuge, {"accel_cubic.cubic[a]": 2.0}),
    ("gyro_g2_sensitivity", centrifuge, {}),
)


def named_first(effect, module, planted, folder, seed):
    """Return the verdict, and the effects of the first group, of a model that lacks an effect of its data."""
    drawn = serial_table.drawn(module.plan(), seed)
    module.generate(folder / str(seed), seed, drawn | planted)
    spec = read_model(ROOT / "models" / f"{module.plan().name}.toml")
    lacking = replace(spec, effects=tuple(each for each in spec.effects if each.name != effect))
    assert len(lacking.effects) == len(spec.effects) - 1
    found = diagnose(joint_fit(bind(lacking, load_campaign(folder / str(seed))), None))
    return found.verdict, found.groups[0].effects if found.groups else ()


@pytest.mark.slow
@pytest.mark.parametrize(("effect", "module", "planted"), HIDDEN, ids=[effect for effect, *_ in HIDDEN])
def test_what_the_model_lacks_is_named_first(effect, module, planted, tmp_path):
    for seed in (1, 2, 3):
        verdict, first = named_first(effect, module, planted, tmp_path, seed)
        print(f"{effect}, seed {seed}: {verdict}, {first}")
        assert verdict in ("missing_effect", "equivalent_effects")
        assert effect in first
