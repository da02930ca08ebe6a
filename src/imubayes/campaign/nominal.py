"""What each channel should read, by nominal numbers alone: enough to tell a wrong unit, not to calibrate."""

import math

import numpy as np

from imubayes.run import Channel, Mounting, Site, Table

EARTH_RATE = 15.041067 / 3600 * math.pi / 180  # rad/s


def level_to_table(table: Table) -> np.ndarray:
    """Return the rotation that takes table coordinates at angle 0 into the local level, C_nt0."""
    azimuth, lean = -table.azimuth, -(math.pi / 2 - table.elevation)
    about_z = np.array(
        [[math.cos(azimuth), -math.sin(azimuth), 0], [math.sin(azimuth), math.cos(azimuth), 0], [0, 0, 1]]
    )
    about_x = np.array([[1, 0, 0], [0, math.cos(lean), -math.sin(lean)], [0, math.sin(lean), math.cos(lean)]])
    return about_z @ about_x


def nominal_input(
    channel: Channel, table: Table, mounting: Mounting, site: Site, rate: np.ndarray, angle: np.ndarray
) -> np.ndarray:
    """Return the nominal input of a channel in rad/s or m/s², shape (R,).

    Parameters
    ----------
    rate, angle : of the table, rad/s and rad; an angle that is NaN is averaged over the turn.
    """
    to_level = level_to_table(table)
    local = np.array([0.0, 0.0, site.gravity])
    if channel.kind == "gyro":
        local = EARTH_RATE * np.array([0.0, math.cos(site.latitude), math.sin(site.latitude)])
    fixed = to_level.T @ local
    cosine, sine = (np.where(np.isnan(angle), 0.0, f(np.nan_to_num(angle))) for f in (np.cos, np.sin))
    in_table = np.stack(
        [cosine * fixed[0] + sine * fixed[1], cosine * fixed[1] - sine * fixed[0], np.full_like(rate, fixed[2])], axis=1
    )
    if channel.kind == "gyro":
        in_table[:, 2] += rate
    return in_table @ mounting.body_to_table @ channel.axes[0]
