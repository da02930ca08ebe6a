"""Exactly the effects that the generator says the readings feel are candidates: over its effects and procedures.

The generator under `data/generators` shares no code with the package.  An effect that shifts its readings must be among
the candidates of the campaign's fit; one that does not must not, and is said to be beyond these runs.
"""

from dataclasses import replace
from pathlib import Path

import accel_channel
import geographic_tumble
import hidden_effects
import numpy as np
import polar_tumble
import pytest
import rotation_modulation
from detectability import look
from hidden import CATALOGUE, Kind
from procedure_plans import PLANS as PROCEDURES
from serial_plans import SerialPlan, write_serial
from simulate import write_simulated
from tumble_plans import TumblePlan, write_tumble

from imubayes.campaign import load_campaign
from imubayes.foundations.errors import InputError
from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import EffectSpec, ModelSpec, read_model
from imubayes.responses.candidate_effects import candidate_responses

ROOT = Path(__file__).parents[2]
SIZES = CATALOGUE | {
    "gyro_scale_factor": Kind("gyro", {"scale": 500.0}),
    "gyro_misalignment": Kind("gyro", {"toward_o": 100.0, "toward_s": 100.0}),
    "accel_scale_factor": Kind("accelerometer", {"scale": 100.0}),
    "accel_misalignment": Kind("accelerometer", {"toward_o": 100.0, "toward_p": 100.0}),
}
PLANS = {
    "geographic-tumble": (geographic_tumble.plan, "geographic-tumble"),
    "polar-tumble": (polar_tumble.plan, "polar-tumble"),
    "accel-channel": (accel_channel.plan, "accel-channel"),
    "rotation-modulation": (rotation_modulation.plan, "rotation-modulation"),
    "hidden-kinematic": (lambda seed: hidden_effects.plan("hidden-kinematic", seed), "hidden-effects"),
    "hidden-gyro": (lambda seed: hidden_effects.plan("hidden-gyro", seed), "hidden-effects"),
    "hidden-thermal": (lambda seed: hidden_effects.plan("hidden-thermal", seed), "hidden-effects-thermal"),
}
RATE = "temperature_rate"
AT_ONCE = ("accel-channel",)
LEAST_FELT = 1e-6
"""Standard deviations of noise that the shifts of all readings together make, below which they show nothing."""


def felt(plan, seed: int = 1) -> dict[str, float]:
    """Return the length of the whitened shift of all readings by each effect at its typical size.

    Effects of channels that the plan has none of are left out: the catalogue's converters serve either kind.
    """
    sight = look(plan, plan.draw(seed))
    found = {}
    for effect, kind in SIZES.items():
        owners = [table.name for table in plan.tables] if kind.on == "head" else []
        owners += [channel.name for channel in plan.channels if channel.kind == kind.on]
        shapes = {name: draw(np.random.default_rng(0)) for name, draw in kind.shapes.items()}
        values = {
            f"{effect}.{name}[{owner}]": value for owner in owners for name, value in (kind.sizes | shapes).items()
        }
        if values or kind.on == "head":
            found[effect] = float(np.linalg.norm(sight.shift(values))) if values else 0.0
    return found


def declared(name: str) -> Model:
    model = PLANS[name][1]
    return bind(read_model(ROOT / "models" / f"{model}.toml"), load_campaign(ROOT / "data" / name))


@pytest.mark.parametrize(
    "name", [name if name in AT_ONCE else pytest.param(name, marks=pytest.mark.slow) for name in PLANS]
)
def test_an_effect_is_a_candidate_where_readings_feel_it(name):
    model, shifts = declared(name), felt(PLANS[name][0](1))
    candidates, unobservable = _candidates(model)
    _assert_felt(model, shifts, candidates, LEAST_FELT)
    # The noise of a thermometer is a rate of the temperature, although that is steady.
    rates = {effect for effect in shifts if RATE in model.registry.effects[effect].needs and _recorded(model, effect)}
    silent = {effect for effect, shift in shifts.items() if shift == 0} - _whole(model) - rates
    assert silent <= unobservable | _of_absent_channels(model), silent - unobservable
    assert not silent & candidates, silent & candidates


@pytest.mark.slow
@pytest.mark.parametrize("procedure", PROCEDURES)
def test_of_every_procedure_by_itself(tmp_path, procedure):
    """The unit, its axes and the plan are drawn; what shifts all readings by less than one sd shows nothing."""
    alone = PROCEDURES[procedure]
    model_file = ROOT / "models" / f"{alone.model}.toml"
    plan = replace(alone.draw(np.random.default_rng(3)), model=model_file)
    write = {SerialPlan: write_serial, TumblePlan: write_tumble}.get(type(plan), write_simulated)
    folder = tmp_path / "campaign"
    folder.mkdir()
    write(folder, plan, 1, values=plan.draw(1), hidden={})
    model = bind(read_model(model_file), load_campaign(folder))
    _assert_felt(model, felt(plan), _candidates(model)[0], 1.0)


def _candidates(model: Model) -> tuple[set[str], set[str]]:
    """Return the candidates of a fit at its priors, and what its runs cannot show."""
    size = model.problem.size
    responses = candidate_responses(Fit(model, np.zeros(size[0]), np.zeros(size[1]), True, ""))
    return {response.scan.effect for response in responses.candidates}, set(responses.unobservable)


def _whole(model: Model) -> set[str]:
    return {effect.name for effect in model.assembly.effects}


def _assert_felt(model: Model, shifts: dict[str, float], candidates: set[str], least: float) -> None:
    """Assert that what shifts the whitened readings by more than the least length is a candidate."""
    recorded = {effect for effect in shifts if _recorded(model, effect)}
    feels = {effect for effect in recorded if shifts[effect] > least} - _whole(model)
    assert feels
    assert feels <= candidates, feels - candidates


def _recorded(model: Model, effect: str) -> bool:
    """Return whether a run has the covariates that an effect needs; a temperature that is held has no rate."""
    return any(set(model.registry.effects[effect].needs) <= supplied for supplied in model.nodes.supplies)


def _of_absent_channels(model: Model) -> set[str]:
    kinds = {channel.kind for channel in model.campaign.channels}
    return {name for name, member in model.registry.effects.items() if not set(member.kinds) & kinds}


def test_scale_factor_at_earth_rate_is_a_candidate():
    """What the table above rests on: nothing turns, and a gyro's scale factor is felt all the same."""
    shifts = felt(geographic_tumble.plan(1))
    assert shifts["gyro_scale_factor"] > 1
    assert shifts["gyro_bias_temperature_rate"] == 0


def test_what_no_run_shows_is_refused_with_the_stimulus_that_would():
    still = declared("geographic-tumble")
    for effect, needed in {"time_skew": "table", "gyro_output_axis_acceleration": "acceleration"}.items():
        entry = EffectSpec(effect, where="model.toml")
        spec = ModelSpec("more", (*still.spec.effects, entry), where="model.toml")
        with pytest.raises(InputError, match="no run can show") as caught:
            bind(spec, still.campaign)
        assert needed in str(caught.value), effect
