"""Bayesian calibration and uncertainty for inertial sensors.

    import imubayes
    result = imubayes.fit("data/trihedral-imu", "models/trihedral-imu.toml")

All runs of a campaign (rate table, dividing head, thermal ramps, free tumble) are fitted jointly with differentiable
forward models; scale factors, misalignment angles, biases and the true mounting angles come with posterior
uncertainty and a statement of what the data did and did not determine.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from imubayes.api import Result, add, diagnose, fit, history, plant
    from imubayes.campaign import check_campaign, load_campaign
    from imubayes.display.comparison import compare
    from imubayes.effects.base import Effect, MotionEffect, Order, PlaceEffect, RecordEffect, SignalEffect, Stage
    from imubayes.effects.memory import Decay, Play
    from imubayes.errors import InputError
    from imubayes.frames import compose, cross, exponential, rotate
    from imubayes.inference.ensemble_sampling import Settings
    from imubayes.model.model_file import read_model as load_model
    from imubayes.noise.base import Entry, EntryNoise, Noise, SeriesNoise, SharedNoise, TailNoise
    from imubayes.parameters.parameter import option, parameter, reference_temperature, time_constant
    from imubayes.run import Campaign
    from imubayes.stimulus import Ambient, Experience, Motion, Sample
    from imubayes.types import Scalar, vector3
    from imubayes.units import dimension, to_si

__version__ = "0.1.0"

# module → its public names
_PUBLIC = {
    "imubayes.api": ("Result", "add", "diagnose", "fit", "history", "plant"),
    "imubayes.campaign": ("check_campaign", "load_campaign"),
    "imubayes.display.comparison": ("compare",),
    "imubayes.inference.ensemble_sampling": ("Settings",),
    "imubayes.model.model_file": ("read_model as load_model",),
    "imubayes.run": ("Campaign",),
    "imubayes.errors": ("InputError",),
    # What a user's own effect or noise is made of.
    "imubayes.effects.base": (
        "Effect", "MotionEffect", "Order", "PlaceEffect", "RecordEffect", "SignalEffect", "Stage",
    ),
    "imubayes.effects.memory": ("Decay", "Play"),
    "imubayes.noise.base": ("Entry", "EntryNoise", "Noise", "SeriesNoise", "SharedNoise", "TailNoise"),
    "imubayes.parameters.parameter": ("option", "parameter", "reference_temperature", "time_constant"),
    "imubayes.stimulus": ("Ambient", "Experience", "Motion", "Sample"),
    "imubayes.frames": ("compose", "cross", "exponential", "rotate"),
    "imubayes.types": ("Scalar", "vector3"),
    "imubayes.units": ("dimension", "to_si"),
}  # fmt: skip
# public name → module and name there
_HOME = {
    entry.split(" as ")[-1]: (module, entry.split(" as ")[0])
    for module, entries in _PUBLIC.items()
    for entry in entries
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used: JAX takes seconds to import, and `--help` needs none of it."""
    if name not in _HOME:
        raise AttributeError(f"module 'imubayes' has no attribute '{name}'")
    module, there = _HOME[name]
    return getattr(import_module(module), there)


def __dir__() -> list[str]:
    """Return the public names with those of the module itself, for completion."""
    return sorted({*globals(), *_HOME})
