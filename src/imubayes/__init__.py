"""Bayesian calibration and uncertainty for inertial sensors.

    import imubayes
    result = imubayes.fit("data/trihedral-imu", "models/trihedral-imu.toml")

All runs of a campaign (rate table, dividing head, thermal ramps, free tumble) are fitted jointly with differentiable
forward models; scale factors, misalignment angles, biases and the true mounting angles come with posterior
uncertainty and a statement of what the data did and did not determine.
"""

from importlib import import_module
from typing import Any

__version__ = "0.1.0"

# public name → module and name there
_HOME = {
    "fit": ("imubayes.api", "fit"),
    "diagnose": ("imubayes.api", "diagnose"),
    "add": ("imubayes.api", "add"),
    "history": ("imubayes.api", "history"),
    "plant": ("imubayes.api", "plant"),
    "Result": ("imubayes.api", "Result"),
    "load_campaign": ("imubayes.campaign", "load_campaign"),
    "check_campaign": ("imubayes.campaign", "check_campaign"),
    "load_model": ("imubayes.model.model_file", "read_model"),
    "compare": ("imubayes.display.comparison", "compare"),
    "Campaign": ("imubayes.run", "Campaign"),
    "Settings": ("imubayes.inference.ensemble_sampling", "Settings"),
    "InputError": ("imubayes.errors", "InputError"),
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used: JAX takes seconds to import, and `--help` needs none of it."""
    if name not in _HOME:
        raise AttributeError(f"module 'imubayes' has no attribute '{name}'")
    module, there = _HOME[name]
    return getattr(import_module(module), there)
