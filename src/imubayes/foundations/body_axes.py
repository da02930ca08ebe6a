"""Vectors in body axes by the nominal calibration of channels whose input axes span three dimensions."""

from collections.abc import Sequence

import numpy as np

from imubayes.foundations.campaign_data import Channel


def spans_space(channels: Sequence[Channel], kind: str) -> bool:
    """Return whether the input axes of the channels of one kind are not coplanar."""
    axes = [channel.axes[0] for channel in channels if channel.kind == kind]
    return len(axes) > 2 and int(np.linalg.matrix_rank(np.array(axes), tol=1e-3)) == 3


def body_vector(readings: np.ndarray, channels: Sequence[Channel], kind: str) -> np.ndarray:
    """Return the least-squares body vector of the channels of one kind, SI, from readings of all: (…, C) → (…, 3)."""
    signal = (readings - [c.offset for c in channels]) / [c.scale_si for c in channels]
    index = [i for i, channel in enumerate(channels) if channel.kind == kind]
    return signal[..., index] @ np.linalg.pinv(np.array([channels[i].axes[0] for i in index])).T
