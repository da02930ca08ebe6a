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

_HOME = {
    "fit": "imubayes.api",
    "load_model": "imubayes.api",
    "Result": "imubayes.api",
    "load_campaign": "imubayes.campaign",
    "check_campaign": "imubayes.campaign",
    "compare": "imubayes.report.comparison",
    "Campaign": "imubayes.run",
    "Settings": "imubayes.inference.sample",
    "InputError": "imubayes.errors",
}

__all__ = sorted(_HOME)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    """Load a public name when it is first used: JAX takes seconds to import, and `--help` needs none of it."""
    if name not in _HOME:
        raise AttributeError(f"module 'imubayes' has no attribute '{name}'")
    return getattr(import_module(_HOME[name]), name)
