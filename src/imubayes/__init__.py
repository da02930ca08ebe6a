"""Bayesian calibration and uncertainty for inertial sensors.

    import imubayes
    result = imubayes.fit("data/trihedral-imu", "models/trihedral-imu.toml")

All runs of a campaign (rate table, dividing head, thermal ramps, free tumble) are fitted jointly with differentiable
forward models; scale factors, misalignment angles, biases and the true mounting angles come with posterior
uncertainty and a statement of what the data did and did not determine.
"""

import lazy_loader

__version__ = "0.1.0"

# The public names stand in `__init__.pyi` and are loaded when they are first used: JAX takes seconds to import, and
# `imubayes --help` needs none of it.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
