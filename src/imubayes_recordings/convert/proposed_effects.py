"""The effects that the runs of a campaign can determine, before anything is fitted.

The model is linear about nominal equipment and sensors, with the noise that the campaign states: the share of the
information on a coefficient that would come from the data follows from the rows alone, not from their readings.  What
equipment and station are uncertain of is always part of the model.  Bias, scale factor and misalignment are, if
these runs show anything of them, or the others depend on them: to leave out a scale factor that one attitude does not
determine would make the bias look too well known.
Further effects are part of it if the runs determine every coefficient, beside all others, and distinguish it from bias,
scale factor and misalignment: of six faces K0 and K2 have hardly more than a sum.  Those that a procedure of the runs
is made for are part of it if the runs determine any coefficient: without them the first fit would fail.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes import observability
from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.inference.linear_information import (
    STATION,
    TOLD,
    LinearInformation,
    likely_scales,
    linear_information,
    of_equipment,
)
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.procedures import PROCEDURES

SENSORS = ("gyro_bias", "gyro_scale_factor", "gyro_misalignment", "accel_bias", "accel_scale_factor",
           "accel_misalignment")  # fmt: skip
FURTHER = ("gyro_g_sensitivity", "gyro_scale_asymmetry", "accel_quadratic", "lever_arm", "gyro_bias_temperature",
           "gyro_bias_temperature_quadratic", "gyro_bias_temperature_cubic", "gyro_scale_temperature",
           "accel_bias_temperature", "accel_bias_temperature_quadratic", "accel_bias_temperature_cubic",
           "accel_scale_temperature", "converter_gain_drift", "converter_offset_drift")  # fmt: skip
IN_MOTION = ("gyro_bandwidth", "accel_bandwidth", "time_skew")
"""Further effects of runs that follow the angle of their table: no sensor is without them."""
NOISE = ("white_noise", "encoder_noise", "run_scatter", "hand_acceleration", "hand_velocity")
DETERMINED = 0.5
"""Least share of the information from the data: of every coefficient of a further effect, and of one that is stated as
determined by the runs."""
# Factor by which a further effect may widen the standard deviation of a bias, scale factor or misalignment, and one of
# these another while it counts as one on which nothing depends.
_WIDENED, _INDEPENDENT = 5.0, 1.1
_HELD, _HELD_RAD = "normal(0, 0.001 arcsec)", 1e-8


@dataclass(frozen=True)
class ProposedEffect:
    """An entry of a model: its settings, and the least and largest share of its coefficients that the data determine.

    The shares are None for equipment, station and noise.
    """

    spec: EffectSpec
    shares: tuple[float, float] | None = None


@dataclass(frozen=True)
class ExpectedUncertainty:
    """What the runs are expected to determine of a coefficient, by the noise that the campaign states.

    The acceleration of a hand, a drill or a wheel is that which the runs in motion show.

    Attributes
    ----------
    effect, channel : of the coefficient.
    sd : expected standard uncertainty, SI.
    unit, factor : unit in which it is shown, and SI units in one of it.
    told : share of the information that comes from the data.
    """

    effect: str
    channel: str
    sd: float
    unit: str
    factor: float
    told: float


@dataclass(frozen=True)
class EffectProposal:
    """The effects of a model for some runs.

    Attributes
    ----------
    effects : in the order of a model file: equipment and station, sensors, further ones, noise.
    undetermined : further effects that the runs show and do not determine, with the largest share they determine.
    missing : effects on channels of the unit that no run can show, with what is missing for each.
    turned_by_hand : whether the accelerometers define the body frame, as no table does.
    expected : of the biases, scale factors and misalignments that are free, beside all effects of the model.
    """

    effects: tuple[ProposedEffect, ...]
    undetermined: dict[str, float]
    missing: dict[str, tuple[str, ...]]
    turned_by_hand: bool
    expected: tuple[ExpectedUncertainty, ...] = ()


def propose_effects(campaign: Campaign) -> EffectProposal:
    """Return the effects that the runs of a campaign can determine.

    Raises
    ------
    InputError
        if not even noise can be bound to the campaign.
    """
    by_hand = _turned_by_hand(campaign)
    purposes = purposes_of(campaign)
    further = tuple(dict.fromkeys((*_further(campaign), *purposes)))
    wanted = (*of_equipment(), *STATION, *SENSORS, *further, *NOISE)
    found = {each.effect_class.name: each.missing for each in observability(campaign)}
    names = [name for name in wanted if not found[name]]
    specs = [spec for name in names for spec in _specs(name, campaign, by_hand)]
    model = bind(ModelSpec(campaign.name, tuple(specs)), campaign)
    known = linear_information(model)
    kept, shares = _kept(known, names, purposes)
    kept |= _delaying(kept) & set(names)
    own = {name: shares.get(name, (0.0, 0.0)) for name in names if name in (*SENSORS, *further)}
    return EffectProposal(
        effects=tuple(ProposedEffect(spec, own.get(spec.name)) for spec in specs if spec.name in kept),
        undetermined={name: largest for name, (_, largest) in own.items() if name not in kept},
        missing={name: found[name] for name in (*SENSORS, *further) if set(found[name]) - {"gyro", "accelerometer"}},
        turned_by_hand=by_hand,
        expected=_expected(_as_recorded(model, known), kept),
    )


def _as_recorded(model: Model, known: LinearInformation) -> LinearInformation:
    """Return the linear model at the noise that runs in motion show: how a hand accelerates, no campaign states."""
    if not any(_in_motion(run) for run in model.campaign.runs):
        return known
    return linear_information(model, likely_scales(model, known.about), known.about)


def _expected(known: LinearInformation, kept: set[str]) -> tuple[ExpectedUncertainty, ...]:
    """Return what is expected of the free coefficients of sensors, with the effects of the model alone."""
    of_model = known.without({*SENSORS, *FURTHER, *NOISE} - kept)
    return tuple(
        ExpectedUncertainty(each.effect, each.label[0], float(own), each.shown_unit, each.factor, float(share))
        for each, own, share in zip(of_model.parameters, of_model.expected_sd, of_model.told, strict=True)
        if each.effect in SENSORS and each.label and each.prior.sd() > _HELD_RAD
    )


def _further(campaign: Campaign) -> tuple[str, ...]:
    """Return the further effects: a unit that is waved has no axis that its sensors could be off by a lever arm."""
    waved = all(_in_motion(run) for run in campaign.runs)
    followed = any("row_seconds" in run.covariates for run in campaign.runs)
    further = (*FURTHER, *IN_MOTION) if followed else FURTHER
    return tuple(name for name in further if not (waved and name == "lever_arm"))


def _in_motion(run: Run) -> bool:
    return run.tumble is not None and run.tumble.in_motion


def purposes_of(campaign: Campaign) -> tuple[str, ...]:
    """Return the effects whose coefficients the procedures of the runs are made to determine."""
    return tuple(dict.fromkeys(name for run in campaign.runs for name in PROCEDURES[run.procedure].purposes))


def _turned_by_hand(campaign: Campaign) -> bool:
    """Return whether there is no fixture: a unit that rests in attitudes that nobody knows, and stated turns of it."""
    apart = [run for run in campaign.runs if run.tumble is None]
    return len(apart) < len(campaign.runs) and all(run.turn_uncertainty is not None for run in apart)


def _delaying(kept: set[str]) -> set[str]:
    """Return the effects that go with others: the lag of an accelerometer delays what its lever arm does."""
    return {"accel_bandwidth"} if "lever_arm" in kept else set()


def _specs(name: str, campaign: Campaign, by_hand: bool) -> Sequence[EffectSpec]:
    """Return the entries of an effect.

    Beside a clock offset a negative lag has the same gain as a positive one, and nearly the same phase: it is positive.
    """
    if name in ("gyro_bandwidth", "accel_bandwidth"):
        return [EffectSpec(name, prior={"tau": "lognormal(1.5 ms, 1)"}, optional=True)]
    return _entries(name, campaign, by_hand)


def _entries(name: str, campaign: Campaign, by_hand: bool) -> Sequence[EffectSpec]:
    """Return the entries of an effect: one, but if a unit turned by hand has its frame by its accelerometers.

    Gravity of unknown direction cannot distinguish a rotation of the unit from one of its axes: the first accelerometer
    lies along its nominal axis, the second in the nominal plane of both.
    """
    if name in NOISE and (own := _noise_by_hand(name, campaign, by_hand)) is not None:
        return (own,)
    turned = [run.turn_uncertainty for run in campaign.runs if run.turn_uncertainty is not None]
    if name == "encoder_noise" and turned:  # the angle of a turn has an error at each end
        return (EffectSpec(name, prior={"sigma": f"lognormal({np.degrees(max(turned)) / np.sqrt(2):.4g} deg, 0.5)"}),)
    accelerometers = campaign.of_kind("accelerometer")
    if name != "accel_misalignment" or not by_hand or len(accelerometers) < 3:
        return (EffectSpec(name, optional=name not in NOISE),)
    first, second, *others = accelerometers
    along = np.abs(second.axes[1:] @ others[0].axes[0])
    across = "toward_o" if along[0] > along[1] else "toward_p"
    return (
        EffectSpec(name, (first.name,), prior={"toward_o": _HELD, "toward_p": _HELD}),
        EffectSpec(name, (second.name,), prior={across: _HELD}),
        EffectSpec(name, tuple(channel.name for channel in others)),
    )


def _noise_by_hand(name: str, campaign: Campaign, by_hand: bool) -> EffectSpec | None:
    """Return the entry of a noise component of a unit by hand; None if its default serves."""
    if name == "white_noise" and all(map(_in_motion, campaign.runs)):
        # Windows of one length cannot distinguish it from the acceleration of the hand; the samples within them can.
        carried = tuple(channel.name for channel in campaign.of_kind("accelerometer"))
        return EffectSpec(name, carried, prior={"sigma": "lognormal(1 noise, 0.2)"})
    if name == "white_noise" and by_hand:  # with room for what is slower than a rest
        return EffectSpec(name, prior={"sigma": "lognormal(2 noise, 1.0)"})
    if name == "hand_acceleration" and len({run.procedure for run in campaign.runs if _in_motion(run)}) > 1:
        return EffectSpec(name, per="run")  # a hand and a wheel do not accelerate the unit alike
    return None


def _kept(
    known: LinearInformation, names: Sequence[str], purposes: Sequence[str]
) -> tuple[set[str], dict[str, tuple[float, float]]]:
    """Return the effects of the model, and the least and largest share of the coefficients of each, beside them."""
    kept, shares, apart = set(names), {}, [name for name in (*FURTHER, *IN_MOTION) if name not in purposes]
    while True:
        # What the model adds by itself, such as the attitudes of a unit turned by hand, stays.
        of_model = known.without(set(names) - kept)
        now = _shares(of_model)
        shares |= now
        below = _below(now, apart, 0, DETERMINED) | _below(now, purposes, 1, DETERMINED) or {
            name: share
            for name, share in _below(now, SENSORS, 1, TOLD).items()
            if of_model.widening(name, SENSORS) < _INDEPENDENT
        }
        if below:
            kept.remove(min(below, key=below.__getitem__))
            continue
        widened = {name: of_model.widening(name, SENSORS) for name in kept & set(apart)}
        if max(widened.values(), default=0.0) <= _WIDENED:
            return kept, shares
        kept.remove(max(widened, key=widened.__getitem__))


def _shares(known: LinearInformation) -> dict[str, tuple[float, float]]:
    """Return the least and largest share of the coefficients of each effect, without those that are held."""
    free = np.array([parameter.prior.sd() >= _HELD_RAD for parameter in known.parameters])
    own = {name: known.told[(known.owner == name) & free] for name in dict.fromkeys(known.owner.tolist())}
    return {name: (float(values.min()), float(values.max())) for name, values in own.items() if len(values)}


def _below(shares: dict[str, tuple[float, float]], names: Sequence[str], end: int, least: float) -> dict[str, float]:
    """Return the effects among some whose least (0) or largest (1) share is too small."""
    return {name: shares[name][end] for name in names if name in shares and shares[name][end] < least}
