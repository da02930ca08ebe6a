"""Text for the operator of a guided capture: one line that changes, and one for each rest that is done."""

from collections.abc import Mapping, Sequence

import numpy as np

from imubayes.display.numbers_and_labels import listed
from imubayes.foundations.units import STANDARD_GRAVITY
from imubayes_recordings.display.expected_lines import expected_lines
from imubayes_recordings.guided_capture import Guidance, Wanted
from imubayes_recordings.guided_capture.planned_motion import HAND

_NEAR = 30.0  # times what is asked for; beyond, a number would say nothing


def now_line(step: Guidance) -> str:
    """Return what to do now."""
    if step.fault:
        return f"{step.part}: {step.fault}" if step.state == "moving" else f"{step.fault} · {step.ask}"
    if step.state == "moving":
        left = f" · {step.ask}" if step.ask else ""
        return f"{step.part} · {step.seconds:.0f} of {step.of:.0f} s{left}"
    if step.ask:
        return step.ask
    if step.state == "begin":
        return "lay the unit down and let go"
    if step.state == "hold":
        return f"hold · {step.seconds:.1f} of {step.of:.0f} s"
    return "turn to another attitude, then let go" if step.up is None else f"turn until {_up(step.up)}, then let go"


def plan_lines(step: Guidance) -> list[str]:
    """Return what the planned motions are expected to determine, and the first of them."""
    moved = f"at {1e3 * HAND / STANDARD_GRAVITY:.1g} mg of hand or drill"
    lines = [f"Standard uncertainties that the planned motions are expected to give, {step.of:g} s each, {moved}:"]
    return [*lines, *(f"  {line}" for line in expected_lines(step.expected)), step.ask]


def rest_line(step: Guidance, wanted: Sequence[Wanted]) -> str:
    """Return what is known after a rest: what is reached of what was asked for, and what is open."""
    line = f"{step.part}: enough" if step.part else f"rest {step.poses}: enough"
    if step.trouble:
        line += f"; no campaign yet: {step.trouble}"
    elif step.largest:
        line += _reached(step.largest, [each for each in wanted if each.effect in step.open], step.state == "done")
    return line if step.state == "done" else f"{line} · {now_line(step)}"


def _reached(largest: Mapping[str, float], open_ones: Sequence[Wanted], done: bool) -> str:
    if not open_ones:
        return "; all requested uncertainties are reached" + (
            "" if done else ", with too few poses to recognise a disturbed one"
        )
    size = {each: largest[each.effect] / each.value for each in open_ones}
    close = {each: ratio for each, ratio in size.items() if ratio < _NEAR}
    near = [f"{each.effect} {each.number * ratio:.2g} of {each.text}" for each, ratio in close.items()]
    far = [each.effect for each in open_ones if each not in close]
    parts = (f"; still open: {listed(near, 6)}" if near else "", f"; undetermined: {listed(far, 6)}" if far else "")
    return "".join(parts)


def _up(direction: np.ndarray) -> str:
    axes = [f"{'+' if part > 0 else '−'}{axis}" for axis, part in zip("xyz", direction, strict=True) if part]
    return f"{axes[0]} points up" if len(axes) == 1 else f"{listed(axes, 3)} point up equally"
