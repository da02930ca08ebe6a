"""What runs are expected to determine, in words: an effect a line, before anything is fitted."""

from collections.abc import Sequence

from imubayes.display.numbers_and_labels import listed, readable
from imubayes_recordings.convert.proposed_effects import DETERMINED, ExpectedUncertainty


def expected_lines(expected: Sequence[ExpectedUncertainty]) -> list[str]:
    """Return a line for each effect: the largest expected standard uncertainty, and the channels that stay open."""
    lines = []
    for effect in dict.fromkeys(each.effect for each in expected):
        own = [each for each in expected if each.effect == effect]
        left = list(dict.fromkeys(each.channel for each in own if each.told < DETERMINED))
        told = [each for each in own if each.channel not in left]
        parts = []
        if told:
            channels = list(dict.fromkeys(each.channel for each in told))
            parts.append(f"{size_of(max(told, key=lambda each: each.sd))} or less ({listed(channels, 6)})")
        if left:
            parts.append(f"not determined: {listed(left, 6)}")
        lines.append(f"{effect}: {'; '.join(parts)}")
    return lines


def size_of(expected: ExpectedUncertainty) -> str:
    """Return an expected standard uncertainty with two digits and its unit."""
    size = expected.sd / expected.factor
    factor, unit = readable(expected.unit, size)
    return f"{float(f'{factor * size:.2g}'):g} {unit}"
