"""The axes that carry a table's inner one: where they bring its frame, and what acts there.

The formulas are those of `imubayes.procedures.serial_axes`, here with the errors of the axes in them.
"""

import equinox as eqx
import jax.numpy as jnp

from imubayes.array_shapes import Matrix3, Vector3
from imubayes.rotations import compose, cross, exponential, rotate_back
from imubayes.signal_path_state import Motion


class Carried(eqx.Module):
    """What the outer axes make of the frame that the inner axis starts from.

    Attributes
    ----------
    to_local : C of that frame to the local level.
    rate, acceleration : its rotation against the Earth, rad/s and rad/s², in that frame.
    force : specific force of a point on the inner axis, m/s², in that frame.
    """

    to_local: Matrix3
    rate: Vector3
    acceleration: Vector3
    force: Vector3


def carried(motion: Motion) -> Carried:
    """Return what the outer axes make of the frame of the inner axis."""
    outer = motion.outer
    if outer is None:
        still = jnp.zeros(3)
        return Carried(motion.base, still, still, rotate_back(motion.base, motion.gravity))
    z, frame = jnp.array([0.0, 0.0, 1.0]), motion.base
    rate = acceleration = jnp.zeros(3)
    force = rotate_back(frame, motion.gravity)
    for place in range(2):
        speed = outer.rate[place] * z
        acceleration = acceleration + outer.acceleration[place] * z + cross(rate, speed)
        turn = exponential(outer.angle[place] * z)
        rate, acceleration, force = (rotate_back(turn, v) for v in (rate + speed, acceleration, force))
        frame = compose(frame, turn)
        velocity = cross(rate, outer.arm[place])
        coriolis = 2 * cross(rotate_back(frame, motion.earth_rate), velocity)
        force = force + cross(rate, velocity) + cross(acceleration, outer.arm[place]) + coriolis
        link = outer.link[place]
        frame = compose(frame, link)
        rate, acceleration, force = (rotate_back(link, v) for v in (rate, acceleration, force))
    return Carried(frame, rate, acceleration, force)
