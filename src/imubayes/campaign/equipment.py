"""Site, channels, tables and mountings of `campaign.toml` as SI records.

Datasheet units are converted and the geometry is validated: input axes must not be zero, mountings must be rotations,
names must be unique.  A servo-table run records the table angle, which is therefore an observed channel.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol, runtime_checkable

import numpy as np

from imubayes.campaign.column_layout import known_columns
from imubayes.campaign.file_schemas import ChannelEntry, MountingEntry, SiteEntry, TableEntry
from imubayes.campaign.toml_documents import Ledger
from imubayes.foundations.campaign_data import PRESETS, THERMOMETERS, Channel, Mounting, Run, Site, Table
from imubayes.foundations.earth import normal_gravity
from imubayes.foundations.errors import closest_first
from imubayes.foundations.units import to_si
from imubayes.procedures import PROCEDURES, procedure_named

DEGREE, ARCMIN, ARCSEC, PPM, MILLIAMPERE, MICROMETRE = (
    to_si(unit) for unit in ("deg", "arcmin", "arcsec", "ppm", "mA", "um")
)
ROTATION_TOLERANCE = 1e-6  # of the orthonormality of a matrix with seven decimals
SQUARENESS = math.sin(1 * DEGREE)  # output axes are orthogonalised if within 1 degree of orthogonal
_ALLOWED_PER = {"gyro": ("deg/s", "deg/h", "rad/s"), "accelerometer": ("g", "m/s^2")}


@runtime_checkable
class RunReferences(Protocol):
    """What a run entry, recorded or planned, refers to."""

    @property
    def name(self) -> str: ...
    @property
    def procedure(self) -> str: ...
    @property
    def table(self) -> str | None: ...
    @property
    def mounting(self) -> str | None: ...
    @property
    def thermometer(self) -> str | None: ...
    @property
    def converter_thermometer(self) -> str | None: ...


def build_site(entry: SiteEntry) -> Site:
    """Return the site in SI; without measured gravity, normal gravity by WGS 84."""
    latitude, measured = entry.latitude_deg * DEGREE, entry.gravity_m_s2
    gravity = normal_gravity(latitude, entry.height_m) if measured is None else measured
    return Site(latitude, entry.height_m, gravity, _times(entry.gravity_uncertainty_ug, to_si("ug", gravity)))


def build_channels(entries: Mapping[int, ChannelEntry], gravity: float, ledger: Ledger) -> tuple[Channel, ...]:
    """Return the valid channels in SI with complete axes; faults go to the ledger."""
    refuse_repeats({index: entry.name for index, entry in entries.items()}, "channel", ledger)
    channels = [_channel(entry, ("channel", index), gravity, ledger) for index, entry in entries.items()]
    return tuple(channel for channel in channels if channel is not None)


def build_tables(entries: Mapping[int, TableEntry], ledger: Ledger) -> dict[str, Table]:
    """Return the tables in SI, by name."""
    refuse_repeats({index: entry.name for index, entry in entries.items()}, "table", ledger)
    return {
        entry.name: Table(
            entry.name,
            0.0 if entry.azimuth_deg == "unknown" else entry.azimuth_deg * DEGREE,
            entry.elevation_deg * DEGREE,
            _times(entry.axis_uncertainty_arcsec, ARCSEC),
            _times(entry.rate_uncertainty_ppm, PPM),
            _times(entry.angle_uncertainty_arcsec, ARCSEC),
            _direction(entry.middle_axis),
            _direction(entry.inner_axis),
            entry.arm_radius_m or 0.0,
            _times(entry.zero_uncertainty_arcsec, ARCSEC),
            _times(entry.squareness_uncertainty_arcsec, ARCSEC),
            _times(entry.intersection_uncertainty_um, MICROMETRE),
            _times(entry.arm_uncertainty_um, MICROMETRE),
            _times(entry.azimuth_uncertainty_arcsec, ARCSEC),
            _times(entry.elevation_uncertainty_arcsec, ARCSEC),
            entry.zero_angle_deg * DEGREE,
            entry.azimuth_deg != "unknown",
        )
        for entry in entries.values()
    }


@dataclass(frozen=True)
class BenchSettings:
    """What a campaign says about the columns of a table, and for the reduction of its raw logs.

    Attributes
    ----------
    settling : time after each change of the stimulus that is left out at least, s.
    rate_tolerance : difference up to which rates are equal, deg/s; None for the noise of the column.
    zero_angle : reading of the angle column at the zero of the table, deg.
    reading_noise : standard deviation of a reading of the angle, deg, if the rate is that of the angle; None if it is
        that of the column of rates.
    """

    settling: float = 0.0
    rate_tolerance: float | None = None
    zero_angle: float = 0.0
    reading_noise: float | None = None


def build_benches(entries: Mapping[int, TableEntry]) -> dict[str, BenchSettings]:
    """Return how the run tables of each table are read, by name."""
    return {
        entry.name: BenchSettings(entry.settling_s, entry.rate_tolerance_deg_s, entry.zero_angle_deg)
        for entry in entries.values()
    }


def build_mountings(entries: Mapping[int, MountingEntry], ledger: Ledger) -> dict[str, Mounting]:
    """Return the mountings in SI, by name; a matrix that is not a rotation goes to the ledger."""
    refuse_repeats({index: entry.name for index, entry in entries.items()}, "mounting", ledger)
    mountings = {}
    for index, entry in entries.items():
        matrix = np.array(entry.body_to_table) if entry.body_to_table else PRESETS[str(entry.preset)]
        path = ("mounting", index, "body_to_table")
        if fault := _not_a_rotation(matrix):
            ledger.add(
                f"body_to_table of mounting '{entry.name}' is not a rotation: {fault}",
                path,
                'three orthonormal rows with determinant +1, or preset = "trihedral" or "aligned"',
                "write column k as body axis k in the table frame, with at least seven decimals",
            )
            continue
        left, _, right = np.linalg.svd(matrix)  # whose product is the nearest rotation
        mountings[entry.name] = Mounting(entry.name, left @ right, _times(entry.uncertainty_arcmin, ARCMIN))
    return mountings


def refuse_repeats(names: Mapping[int, str], section: str, ledger: Ledger) -> None:
    """Add an issue to the ledger for every repeated name of a section."""
    first: dict[str, int] = {}
    for index, name in names.items():
        if name in first:
            ledger.add(
                f"the {section} name '{name}' is given twice",
                (section, index, "name"),
                f"a name not yet used (first use: {ledger.where(section, first[name], 'name')})",
                f"rename one of the two {section}s",
            )
        first.setdefault(name, index)


def refuse_reserved_names(channels: Mapping[int, ChannelEntry], names: Sequence[str], ledger: Ledger) -> None:
    """Add an issue to the ledger for every channel named like another column of run tables.

    `names` are the names of all channels, those of invalid entries included.
    """
    reserved = {*known_columns(), *(f"{name}_sd" for name in names)}
    for index, channel in channels.items():
        if channel.name in reserved:
            ledger.add(
                f"the channel name '{channel.name}' is reserved for another column of run tables",
                ("channel", index, "name"),
                "a name that is neither a known column nor '<channel>_sd'",
                "rename the channel and its column",
            )


def check_references(run: RunReferences, index: int, names: Mapping[str, Sequence[str]], ledger: Ledger) -> None:
    """Add an issue for equipment that a run names but the file lacks, and for what it needs and does not name.

    Parameters
    ----------
    index : of the run in its file.
    names : section (`table`, `mounting`, `thermometer`) → names that the file defines.
    """
    named = {"table": "table", "mounting": "mounting"} | dict.fromkeys(THERMOMETERS, "thermometer")
    for key, section in named.items():
        name, defined = getattr(run, key), names[section]
        if name is None and key not in THERMOMETERS and procedure_named(run.procedure).needs_table:
            ledger.add(
                f"run '{run.name}' of procedure '{run.procedure}' has no '{section}'",
                ("run", index, key),
                ", ".join(defined) or f"the name of a [[{section}]]",
                f"name the {section} of the run",
            )
        elif name is not None and name not in defined:
            ledger.add(
                f"run '{run.name}' refers to the {section} '{name}', which is not defined",
                ("run", index, key),
                closest_first(name, defined) or f"none is defined: add a [[{section}]]",
                f"correct the name, or add the {section}",
            )


def require_current_scale(channels: Iterable[ChannelEntry], run: int, ledger: Ledger) -> None:
    """Add an issue, at the run of that index, if no channel states its current per acceleration."""
    if not any(channel.current_mA_per_g for channel in channels):
        ledger.add(
            "a current is injected, but no channel has 'current_mA_per_g'",
            ("run", run, "procedure"),
            "current_mA_per_g = … in a [[channel]]",
            "add current_mA_per_g to the channel under test",
        )


def complete_axes(input_axis: np.ndarray, output_axis: np.ndarray | None) -> np.ndarray:
    """Return the unit vectors I, O, S as rows, shape (3, 3): O orthogonalised to I, S = I × O.

    Without an output axis, O is derived from the body axis least aligned with I (x before y before z).
    """
    first = input_axis / np.linalg.norm(input_axis)
    start = np.eye(3)[np.argmin(np.round(np.abs(first), 12))] if output_axis is None else output_axis
    second = start - (start @ first) * first
    second /= np.linalg.norm(second)
    return np.stack([first, second, np.cross(first, second)])


def _channel(entry: ChannelEntry, path: tuple[str, int], gravity: float, ledger: Ledger) -> Channel | None:
    before = len(ledger.issues)
    input_axis = np.array(entry.input_axis, dtype=float)
    output_axis = None if entry.output_axis is None else np.array(entry.output_axis, dtype=float)
    if np.linalg.norm(input_axis) < 1e-9:
        ledger.add(
            f"the input axis of channel '{entry.name}' is a zero vector",
            (*path, "input_axis"),
            "a direction in the body frame, such as [1, 0, 0]",
            "give the nominal direction of the sensitive axis",
        )
    elif output_axis is not None:
        _check_output_axis(entry, input_axis, output_axis, path, ledger)
    if entry.scale == 0:
        ledger.add(
            f"the nominal scale of channel '{entry.name}' is zero",
            (*path, "scale"),
            "output units per input unit, negative for a reversed output",
            "give the nominal scale of the datasheet",
        )
    if entry.per not in _ALLOWED_PER[entry.kind]:
        ledger.add(
            f"a {entry.kind} cannot have its scale per '{entry.per}'",
            (*path, "per"),
            ", ".join(_ALLOWED_PER[entry.kind]),
            "correct 'per' or 'kind'",
        )
    if len(ledger.issues) > before:
        return None
    current = entry.current_mA_per_g
    return Channel(
        entry.name,
        entry.kind,
        complete_axes(input_axis, output_axis),
        entry.output_unit,
        float(entry.scale),
        entry.per,
        entry.scale / to_si(entry.per, gravity),
        float(entry.offset),
        entry.noise,
        None if current is None else current * MILLIAMPERE / gravity,
    )


def _check_output_axis(
    entry: ChannelEntry, input_axis: np.ndarray, output_axis: np.ndarray, path: tuple[str, int], ledger: Ledger
) -> None:
    length = float(np.linalg.norm(output_axis))
    cosine = abs(input_axis @ output_axis) / (np.linalg.norm(input_axis) * length) if length > 1e-9 else 1.0
    if cosine > SQUARENESS:
        fault = "is a zero vector" if length <= 1e-9 else "is not orthogonal to its input axis"
        ledger.add(
            f"the output axis of channel '{entry.name}' {fault}",
            (*path, "output_axis"),
            "a direction orthogonal to input_axis, to within 1 degree",
            "correct output_axis, or leave it out",
        )


def _not_a_rotation(matrix: np.ndarray) -> str:
    determinant = float(np.linalg.det(matrix))
    worst = float(np.max(np.abs(matrix.T @ matrix - np.eye(3))))
    if abs(determinant) < 1e-9:
        return "it is singular"
    if worst > ROTATION_TOLERANCE:
        return f"its columns deviate from orthonormality by up to {worst:.2g}"
    return "its determinant is -1 (a mirror image)" if determinant < 0 else ""


def _direction(vector: Sequence[float] | None) -> tuple[float, float, float] | None:
    if vector is None:
        return None
    x, y, z = (component / math.hypot(*vector) for component in vector)
    return x, y, z


def _times(value: float | None, factor: float) -> float | None:
    return None if value is None else value * factor


ANGLE, ANGLE_UNIT = "table_angle", "deg"


def with_angles(
    channels: tuple[Channel, ...], runs: Sequence[Run], tables: Mapping[str, Table]
) -> tuple[tuple[Channel, ...], tuple[Run, ...]]:
    """Return channels and runs with the table angle as an additional channel, if a gyro drives a table.

    The gyro outputs of such a run are the servo error and are excluded.
    """
    driven = [run for run in runs if PROCEDURES[run.procedure].driven]
    if not driven:
        return channels, tuple(runs)
    stated = [tables[run.table].angle_uncertainty for run in driven if run.table is not None]
    noise = max((uncertainty for uncertainty in stated if uncertainty), default=None)
    sd = None if noise is None else float(np.degrees(noise))
    angle = Channel(ANGLE, "angle", np.eye(3), ANGLE_UNIT, 1.0, ANGLE_UNIT, 1 / to_si(ANGLE_UNIT), noise=sd)
    return (*channels, angle), tuple(_with_angle(run) for run in runs)


def _with_angle(run: Run) -> Run:
    unknown = np.full((run.rows, 1), np.nan)
    observed, others, samples, notes = unknown, run.observed, run.samples, run.notes
    if PROCEDURES[run.procedure].driven:
        turning = np.unwrap(run.covariates["table_angle"])
        run = replace(run, covariates={**run.covariates, "table_angle": turning})
        observed = np.degrees(turning)[:, None]
        if np.isfinite(others).any():
            notes = (*notes, "outputs of the unit are excluded: the servo loop nulls the gyro that drives the table")
        others, samples = np.full_like(others, np.nan), np.ones(run.rows)
    return replace(
        run,
        observed=np.concatenate([others, observed], axis=1),
        sample_sd=np.concatenate([run.sample_sd, unknown], axis=1),
        samples=samples,
        notes=notes,
    )
