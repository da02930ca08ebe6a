"""Whether gyros and accelerometers read in one right-handed system: reversed and exchanged axes, found by gravity.

The gyros carry the direction of gravity from one instant to the next, where the accelerometers observe it.  Each change
of the axes that a laboratory makes is tried: one channel reversed, all gyros reversed, gyros exchanged, with any
signs, and two accelerometers exchanged.
A reversed accelerometer is invisible in |f| = g, and a fit would absorb it in other parameters.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations, permutations, product

import numpy as np

from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel

# Changes that leave as much of the error as the best one, to this factor, are not distinguished: the simplest is named.
_ALIKE = 1.1
ALLOWED = "axes of one right-handed system, for gyros and accelerometers alike"


@dataclass(frozen=True)
class AxisChange:
    """A change of the input axes of some channels.

    Attributes
    ----------
    name : of the finding.
    words : for "with … it is", such as ``'gx' reversed``.
    remedy : lines of the campaign file to check or write.
    force, rate : shape (3, 3), from nominal body vectors to those with the change.
    """

    name: str
    words: str
    remedy: str
    force: np.ndarray
    rate: np.ndarray


def axis_changes(channels: Sequence[Channel]) -> tuple[AxisChange, ...]:
    """Return the changes of axes that are tried, the simplest first, of channels that span space."""
    gyros = [channel for channel in channels if channel.kind == "gyro"]
    accelerometers = [channel for channel in channels if channel.kind == "accelerometer"]
    one = [
        *(_reversed([each], accelerometers, gyros) for each in accelerometers),
        *(_reversed([each], gyros, gyros) for each in gyros),
        _reversed(gyros, gyros, gyros),
    ]
    exchanges = _exchanges(gyros)
    plain = [change for negative, change in exchanges if not negative]
    signed = [change for negative, change in exchanges if negative]
    return (*one, *plain, *(_renamed(pair, accelerometers) for pair in combinations(accelerometers, 2)), *signed)


def best_change(
    changes: Sequence[AxisChange], error: Callable[[AxisChange], float], largest: float
) -> tuple[AxisChange, float] | None:
    """Return the simplest change that leaves as little of an error as the best one, with it; None if that is too much.

    Parameters
    ----------
    error : of gravity carried by the gyros with a change.
    largest : error that a change may leave.
    """
    errors = np.array([error(change) for change in changes])
    place = int(np.argmax(errors <= _ALIKE * errors.min()))
    return (changes[place], float(errors[place])) if errors[place] < largest else None


def finding_of(change: AxisChange, what: str, file: str) -> Finding:
    """Return the warning about a change of axes; `what` says what it mends."""
    return Finding(change.name, "warning", "", what, file, ALLOWED, change.remedy)


def _named(channels: Sequence[Channel]) -> str:
    return ", ".join(f"'{channel.name}'" for channel in channels)


def _axes(channels: Sequence[Channel]) -> np.ndarray:
    return np.array([channel.axes[0] for channel in channels])


def _reversed(reversed_: Sequence[Channel], kind: Sequence[Channel], gyros: Sequence[Channel]) -> AxisChange:
    """Return that channels, of those of a kind, are reversed."""
    axes, sign = _axes(kind), np.array([-1.0 if channel in reversed_ else 1.0 for channel in kind])
    turned = np.linalg.pinv(axes) @ (sign[:, None] * axes)
    remedy = f"check the sign of input_axis of {_named(reversed_)}"
    if kind[0].kind == "gyro":
        return AxisChange("sign_reversed", f"{_named(reversed_)} reversed", remedy, np.eye(3), turned)
    # f → F f and ω → det(F) F⁻ᵀ ω leave the motion of gravity, −ω × f, as it is.
    like = np.linalg.det(turned) * np.linalg.inv(turned).T
    other = [each for each in gyros if np.allclose(like @ each.axes[0], -each.axes[0], atol=1e-6)]
    if other and np.allclose(_reversed(other, gyros, gyros).rate, like, atol=1e-6):
        remedy += f", or of {_named(other)}: this recording does not distinguish the two"
    return AxisChange("sign_reversed", f"{_named(reversed_)} reversed", remedy, turned, np.eye(3))


def _renamed(pair: tuple[Channel, Channel], kind: Sequence[Channel]) -> AxisChange:
    """Return that the columns of two accelerometers are exchanged."""
    axes, order = _axes(kind), list(range(len(kind)))
    one, other = (next(k for k, each in enumerate(kind) if each is channel) for channel in pair)
    order[one], order[other] = other, one
    turned = np.linalg.pinv(axes) @ axes[order]
    names = _named(pair)
    return AxisChange("axes_do_not_fit", f"{names} exchanged", f"exchange the columns {names}", turned, np.eye(3))


def _exchanges(gyros: Sequence[Channel]) -> list[tuple[int, AxisChange]]:
    """Return the exchanges of axes of the gyros, with any signs and their number; plain ones first."""
    found = []
    for order in permutations(range(3)):
        for sign in product([1.0, -1.0], repeat=3):
            turned = np.array(sign)[:, None] * np.eye(3)[list(order)]
            if order != (0, 1, 2):
                found.append((sum(each < 0 for each in sign), _exchanged(gyros, turned)))
    return sorted(found, key=lambda each: each[0])


def _exchanged(gyros: Sequence[Channel], turned: np.ndarray) -> AxisChange:
    moved = [(each, turned @ each.axes[0]) for each in gyros if not np.allclose(turned @ each.axes[0], each.axes[0])]
    lines = "; ".join(
        f"'{each.name}': input_axis = [{', '.join(f'{value:.6g}' for value in axis + 0.0)}]" for each, axis in moved
    )
    words = "the axes of gyros exchanged"
    return AxisChange("axes_do_not_fit", words, f"these axes would agree: {lines}", np.eye(3), turned)
