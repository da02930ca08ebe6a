"""The trihedral campaign as an engineer would write it in NumPy: a function per run, vectorised over rows and channels.

It knows the effects of `models/trihedral-imu.toml` and no others; it has no registry, no derivatives and no JAX.  Its
residual is the same to rounding as the package's, which the benchmark checks before it compares times.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Run
from imubayes.foundations.earth import earth_rate, table_to_local
from imubayes.parameters.declarations import Layout

REFERENCE_TEMPERATURE = 25.0
TURN_ANGLES = 2 * np.pi * np.arange(4) / 4


class PlainModel:
    """Residuals of the campaign at fixed noise scales, as a function of z.

    Parameters
    ----------
    campaign : in SI.
    layout : the parameters, whose priors are all normal.
    sigma, tau : white noise of one sample and scatter of runs, per channel in output units.
    """

    def __init__(self, campaign: Campaign, layout: Layout, sigma: Sequence[float], tau: Sequence[float]):
        self.campaign = campaign
        self.place = {name: index for index, name in enumerate(layout.names)}
        self.mean = np.array([float(one.prior.mean) for one in layout.parameters])
        self.sd = np.array([float(one.prior.deviation) for one in layout.parameters])
        self.sigma, self.tau = np.asarray(sigma), np.asarray(tau)
        self.gravity = np.array([0.0, 0.0, campaign.site.gravity])
        self.earth = earth_rate(campaign.site.latitude)
        self.base = {one.name: table_to_local(one.azimuth, one.elevation) for one in campaign.tables.values()}
        self.gyro = [i for i, one in enumerate(campaign.channels) if one.kind == "gyro"]
        self.accel = [i for i, one in enumerate(campaign.channels) if one.kind == "accelerometer"]
        self.axes = np.stack([one.axes for one in campaign.channels])
        self.scale = np.array([one.scale_si for one in campaign.channels])
        self.offset = np.array([one.offset for one in campaign.channels])
        self.nodes = {run.name: angles_of(run) for run in campaign.runs}
        names = [one.name for one in campaign.channels]
        self.gyros, self.accels = [names[i] for i in self.gyro], [names[i] for i in self.accel]
        self.columns = {
            f"{effect}.{field}": np.array([self.place[f"{effect}.{field}[{name}]"] for name in channels])
            for channels, effects in ((self.gyros, GYRO_EFFECTS), (self.accels, ACCEL_EFFECTS))
            for effect, fields in effects.items()
            for field in fields
        }

    def residuals(self, z: np.ndarray) -> np.ndarray:
        """Return whitened residuals of all runs, then z."""
        values = self.mean + self.sd * z
        return np.concatenate([*(self.whitened(run, self.outputs(run, values)) for run in self.campaign.runs), z])

    def outputs(self, run: Run, values: np.ndarray) -> np.ndarray:
        """Return what the run should read, shape (rows, channels): means over the angles of each row."""
        row, angle, mean = self.nodes[run.name]
        return mean @ self.at_angles(run, values, row, angle)

    def at_angles(self, run: Run, values: np.ndarray, row: np.ndarray, angle: np.ndarray) -> np.ndarray:
        """Return outputs during given rows at given table angles, shape (n, channels)."""

        def of(name: str) -> np.ndarray:
            return values[self.columns[name]]

        def named(name: str) -> float:
            return values[self.place[name]]

        tilt = [named(f"table_axis_tilt.{axis}[{run.table}]") for axis in "xy"]
        seat = [named(f"mounting_error.{axis}[{run.mounting}]") for axis in "xyz"]
        table = self.base[run.table] @ rotation([*tilt, 0.0])
        body = self.campaign.mountings[run.mounting].body_to_table @ rotation(seat)
        rate_error = f"table_rate_error.rate_error[{run.table}]"
        error = named(rate_error) if rate_error in self.place else 0.0
        rate = run.covariates["table_rate"][row] * (1 + error)
        warm = (run.covariates["temperature"][row] - REFERENCE_TEMPERATURE)[:, None]
        cosine, sine = np.cos(angle), np.sin(angle)
        turn = np.outer(rate, body[2])
        turning = turn + about_z(self.earth @ table, cosine, sine) @ body
        force = about_z(self.gravity @ table, cosine, sine) @ body

        # gyros
        axes = self.axes[self.gyro]
        along_i, along_o, along_s = (turning @ axes[:, k].T for k in range(3))
        force_i, force_o, force_s = (force @ axes[:, k].T for k in range(3))
        lean_o, lean_s = of("gyro_misalignment.toward_o"), of("gyro_misalignment.toward_s")
        signal = (along_i + lean_o * along_o + lean_s * along_s) / np.sqrt(1 + lean_o**2 + lean_s**2)
        signal = signal + of("gyro_g_sensitivity.d_i") * force_i + of("gyro_g_sensitivity.d_o") * force_o
        signal = signal + of("gyro_g_sensitivity.d_s") * force_s
        signal = signal + of("gyro_bias.bias") + of("gyro_bias_temperature.slope") * warm
        gyro = signal * (1 + of("gyro_scale_factor.scale")) * (1 + of("gyro_scale_temperature.slope") * warm)

        # accelerometers
        axes = self.axes[self.accel]
        lever = np.stack([of(f"lever_arm.{axis}") for axis in "xyz"], axis=1)
        across = lever @ turn.T  # (channels, n)
        felt = force[:, None] + turn[:, None] * across.T[..., None] - (turn**2).sum(axis=1)[:, None, None] * lever
        force_i, force_o, force_p = (np.einsum("nck,ck->nc", felt, axes[:, k]) for k in range(3))
        lean_o, lean_p = of("accel_misalignment.toward_o"), of("accel_misalignment.toward_p")
        signal = (force_i + lean_o * force_o + lean_p * force_p) / np.sqrt(1 + lean_o**2 + lean_p**2)
        signal = signal + of("accel_quadratic.quadratic") * force_i**2
        signal = signal + of("accel_bias.bias") + of("accel_bias_temperature.slope") * warm
        accel = signal * (1 + of("accel_scale_factor.scale")) * (1 + of("accel_scale_temperature.slope") * warm)

        output = np.empty((len(rate), len(self.scale)))
        output[:, self.gyro], output[:, self.accel] = gyro, accel
        return output * self.scale + self.offset

    def whitened(self, run: Run, predicted: np.ndarray) -> np.ndarray:
        """Return L⁻¹ of the residual, L Lᵀ = σ²/n + τ² 1 1ᵀ for each channel of a run, row by row."""
        scaled = (run.observed - predicted) * np.sqrt(run.samples)[:, None] / self.sigma
        direction = np.sqrt(run.samples)[:, None] / self.sigma
        square = (direction**2).sum(axis=0)
        shrink = (1 - 1 / np.sqrt(1 + self.tau**2 * square)) / square
        return (scaled - direction * (shrink * (direction * scaled).sum(axis=0))).ravel()


GYRO_EFFECTS = {
    "gyro_bias": ("bias",),
    "gyro_scale_factor": ("scale",),
    "gyro_misalignment": ("toward_o", "toward_s"),
    "gyro_bias_temperature": ("slope",),
    "gyro_scale_temperature": ("slope",),
    "gyro_g_sensitivity": ("d_i", "d_o", "d_s"),
}
ACCEL_EFFECTS = {
    "accel_bias": ("bias",),
    "accel_scale_factor": ("scale",),
    "accel_misalignment": ("toward_o", "toward_p"),
    "accel_bias_temperature": ("slope",),
    "accel_scale_temperature": ("slope",),
    "accel_quadratic": ("quadratic",),
    "lever_arm": ("x", "y", "z"),
}


def angles_of(run: Run) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return for each node of a run its row and table angle, and the matrix (rows, nodes) that takes the means."""
    angle = run.covariates["table_angle"]
    count = np.where(np.isnan(angle), len(TURN_ANGLES), 1)
    row = np.repeat(np.arange(len(angle)), count)
    at = np.concatenate([TURN_ANGLES if np.isnan(one) else [one] for one in angle])
    return row, at, (row == np.arange(len(angle))[:, None]) / count[:, None]


def rotation(vector: Sequence[float]) -> np.ndarray:
    """Return exp([vector]×) by Rodrigues' formula."""
    x, y, z = vector
    angle = np.sqrt(x * x + y * y + z * z)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    if angle == 0:
        return np.eye(3)
    return np.eye(3) + np.sin(angle) / angle * cross + 2 * (np.sin(angle / 2) / angle) ** 2 * cross @ cross


def about_z(vector: np.ndarray, cosine: np.ndarray, sine: np.ndarray) -> np.ndarray:
    """Return a vector fixed in the room as the turned table sees it: Rz(angle)ᵀ · vector, shape (n, 3)."""
    x, y, z = vector
    return np.stack([x * cosine + y * sine, y * cosine - x * sine, np.full_like(cosine, z)], axis=1)
