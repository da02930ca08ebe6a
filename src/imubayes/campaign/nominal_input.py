"""What each channel should read, by nominal numbers alone: enough to tell a wrong unit, not to calibrate."""

import numpy as np

from imubayes.earth import earth_rate, table_to_local
from imubayes.run import Channel, Mounting, Site, Table


def nominal_input(
    channel: Channel, table: Table, mounting: Mounting, site: Site, rate: np.ndarray, angle: np.ndarray
) -> np.ndarray:
    """Return the nominal input of a channel in rad/s or m/s², shape (R,).

    Parameters
    ----------
    rate, angle : of the table, rad/s and rad; an angle that is NaN is averaged over the turn.
    """
    to_level = table_to_local(table.azimuth, table.elevation)
    local = earth_rate(site.latitude) if channel.kind == "gyro" else np.array([0.0, 0.0, site.gravity])
    fixed = to_level.T @ local
    cosine, sine = (np.where(np.isnan(angle), 0.0, f(np.nan_to_num(angle))) for f in (np.cos, np.sin))
    in_table = np.stack(
        [cosine * fixed[0] + sine * fixed[1], cosine * fixed[1] - sine * fixed[0], np.full_like(rate, fixed[2])], axis=1
    )
    if channel.kind == "gyro":
        in_table[:, 2] += rate
    return in_table @ mounting.body_to_table @ channel.axes[0]
