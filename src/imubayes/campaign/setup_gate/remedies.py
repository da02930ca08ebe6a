"""How every kind of set-up mistake is said: what is wrong, where it stands, and the line to write instead."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from imubayes.campaign.setup_gate import equipment_mistakes as bench
from imubayes.campaign.setup_gate import mounting_mistakes as seats
from imubayes.campaign.setup_gate import output_mistakes as outputs
from imubayes.campaign.setup_gate import reading_mistakes as reading
from imubayes.campaign.setup_gate.explanations import Explanation
from imubayes.campaign.setup_gate.places import Places, subject_of
from imubayes.campaign.setup_gate.record_remedies import RECORD_REMEDIES
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import Issue


def _degrees(angle: float) -> float:
    """Return an angle in deg as one would state it: whole if it is nearly that, else to a tenth."""
    whole = round(angle)
    return float(whole) if abs(angle - whole) < 0.15 else round(angle, 1)


def _folded(angle: float) -> float:
    """Return an angle in deg, within −180 … 180, the end above included."""
    folded = _degrees((angle + 180) % 360 - 180)
    return 180.0 if folded == -180 else folded + 0.0


def _uncertainty(found: Explanation) -> str:
    """Return the uncertainty of a size in words, if it has one worth saying."""
    degrees = math.degrees(found.uncertainty)
    return f" (± {degrees:.1f} deg)" if degrees >= 0.05 else ""


def _zero(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake, subject, off = found.mistake, subject_of(found.mistake), _folded(-math.degrees(found.size))
    what = f"the zero of the table angle is off by {off:+g} deg{_uncertainty(found)} {subject}"
    allowed = "angles counted from the position at which the axes are as the [[table]] states"
    if mistake.scope.section == "table":
        zero = _folded(places.zero(mistake.scope.name) + off)
        where = places.line("table", mistake.scope.name, "zero_angle_deg")
        remedy = f"write zero_angle_deg = {zero:g} for table '{mistake.scope.name}'"
        return Issue(what, where, allowed, remedy)
    remedy = f"add {_folded(-off):+g} to column 'table_angle_deg' of {places.file(mistake.scope.name)}"
    return Issue(what, places.column(mistake, "table_angle_deg"), allowed, remedy)


def _axis_zero(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    axis, off = found.mistake.variant, _folded(-math.degrees(found.size))
    column = f"{axis}_angle_deg"
    return Issue(
        f"the zero of the angle of the {axis} axis is off by {off:+g} deg{_uncertainty(found)} "
        f"{subject_of(found.mistake)}",
        places.column(found.mistake, column),
        "angles counted from the position at which the axes are as the [[table]] states",
        f"add {_folded(-off):+g} to column '{column}' {subject_of(found.mistake)}",
    )


def _axis_sense(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    axis, *names = found.mistake.variant.split()
    columns = [f"{axis}_{'angle_deg' if name == 'angle' else 'rate_deg_s'}" for name in names]
    what = f"the {axis} axis turns against the stated sense"
    if len(columns) == 1:
        what = f"column '{columns[0]}' has the opposite sign"
    return Issue(
        f"{what} {subject_of(found.mistake)}",
        places.column(found.mistake, columns[0]),
        "rates and angles right-handed about the axis",
        f"reverse the sign of {' and '.join(f"'{each}'" for each in columns)} {subject_of(found.mistake)}",
    )


def _axis_columns(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    first, second = found.mistake.variant.split()
    return Issue(
        f"the columns of the axes '{first}' and '{second}' are exchanged {subject_of(found.mistake)}",
        places.column(found.mistake, f"{first}_angle_deg"),
        "angles and rates of each axis in its own columns",
        f"exchange the columns '{first}_…' and '{second}_…' {subject_of(found.mistake)}",
    )


def _turned(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    name, by = found.mistake.scope.name, _folded(math.degrees(found.size))
    turn = math.radians(by)
    about = np.array([[math.cos(turn), -math.sin(turn), 0], [math.sin(turn), math.cos(turn), 0], [0, 0, 1]])
    return Issue(
        f"mounting '{name}' is turned by {by:+g} deg{_uncertainty(found)} about the axis of the table",
        places.line("mounting", name, "body_to_table"),
        "body_to_table of the unit as it was mounted",
        f"write body_to_table = {_rows(about @ campaign.mountings[name].body_to_table)}, or correct the angles",
    )


def _rows(matrix: np.ndarray) -> str:
    return str((np.round(matrix, 6) + 0.0).tolist())


def _sense(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    return Issue(
        f"the table turns against the stated sense {subject_of(found.mistake)}",
        places.column(found.mistake, "table_angle_deg"),
        "rates and angles right-handed about the axis of the table",
        f"reverse the sign of 'table_rate_deg_s' and 'table_angle_deg' {subject_of(found.mistake)}"
        + (f" and of zero_angle_deg of the table '{found.mistake.scope.name}'" if found.mistake.variant else ""),
    )


def _table_of(campaign: Campaign, mistake: bench.Mistake) -> str:
    if mistake.scope.section == "table":
        return mistake.scope.name
    return next(str(run.table) for run in campaign.runs if run.name == mistake.scope.name)


def _elevation(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    name = _table_of(campaign, found.mistake)
    stated = math.degrees(campaign.tables[name].elevation)
    actual = _folded(stated + math.degrees(found.size))
    over = abs(actual) > 90
    elevation = math.copysign(180, actual) - actual if over else actual
    if over and abs(elevation - stated) < 1:
        azimuth = (math.degrees(campaign.tables[name].azimuth) + 180) % 360
        return Issue(
            f"the axis of table '{name}' points the other way {subject_of(found.mistake)}",
            places.line("table", name, "azimuth_deg"),
            "the azimuth of the axis, clockwise from North",
            f"write azimuth_deg = {azimuth:g}, and turn zero_angle_deg by 180",
        )
    return Issue(
        f"the elevation of the axis of table '{name}' is {elevation:g} deg{_uncertainty(found)}, "
        f"not {stated:g} deg "
        f"{subject_of(found.mistake)}",
        places.line("table", name, "elevation_deg"),
        "the elevation of the axis above the horizontal",
        f"write elevation_deg = {elevation:g}" + (", and turn azimuth_deg and zero_angle_deg by 180" if over else ""),
    )


def _azimuth(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    name = found.mistake.scope.name
    stated = math.degrees(campaign.tables[name].azimuth)
    actual = round(stated + math.degrees(found.size)) % 360
    return Issue(
        f"the azimuth of the axis of table '{name}' is about {actual:g} deg{_uncertainty(found)}, not {stated:g} deg",
        places.line("table", name, "azimuth_deg"),
        "the azimuth of the axis, clockwise from North",
        f"write azimuth_deg = {actual:g}, as exactly as it is known",
    )


def _label(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, seats.MountingMislabelled)
    name = mistake.scope.name
    what = f"the unit sat in mounting '{mistake.actual}' {subject_of(mistake)}"
    if mistake.scope.section == "run":
        remedy = f"write mounting = \"{mistake.actual}\" for run '{name}'"
        return Issue(what, places.line("run", name, "mounting"), "the mounting that the run was made in", remedy)
    remedy = f"write body_to_table = {_rows(mistake.matrix)} for mounting '{name}', that of '{mistake.actual}'"
    return Issue(what, places.line("mounting", name, "body_to_table"), "the orientation of the unit", remedy)


def _seats(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, seats.MountingsExchanged)
    first, second = mistake.first, mistake.second
    on = f" on table '{mistake.scope.name}'" if mistake.scope.section == "table" else ""
    runs = [(run.name, run.mounting) for run in campaign.runs if not on or run.table == mistake.scope.name]
    named = [name for name, mounting in runs if mounting in (first, second)]
    return Issue(
        f"mountings '{first}' and '{second}' are exchanged in all runs{on}",
        places.line("run", named[0], "mounting"),
        "the mounting that the run was made in",
        f'exchange mounting = "{first}" and mounting = "{second}" of the runs '
        + ", ".join(f"'{name}'" for name in named),
    )


def _files(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, bench.FilesExchanged)
    first, second = mistake.scope.name, mistake.second
    return Issue(
        f"the tables of runs '{first}' and '{second}' are exchanged",
        f"{places.line('run', first, 'file')} and {places.line('run', second, 'file')}",
        "the file of the run itself",
        f"exchange them: write file = \"{places.file(second)}\" for run '{first}' and "
        f"file = \"{places.file(first)}\" for run '{second}'",
    )


def _matrix(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, (seats.MountingWrong, seats.MountingAngles))
    name, run = mistake.scope.name, mistake.scope.section == "run"
    what = "the unit sat in another orientation"
    if isinstance(mistake, seats.MountingWrong) and mistake.transposed:
        what = "the transpose of body_to_table fits"
    remedy = f"write body_to_table = {_rows(mistake.matrix)}"
    return Issue(
        f"{what} {subject_of(mistake)}",
        places.line("run", name, "mounting") if run else places.line("mounting", name, "body_to_table"),
        "column k of body_to_table is body axis k in the table frame",
        f"{remedy} in a mounting of its own" if run else f"{remedy} for mounting '{name}'",
    )


def _latitude(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    latitude = math.degrees(campaign.site.latitude)
    return Issue(
        f"the gyros show the Earth rate at latitude {-latitude:.6g} deg, not {latitude:.6g} deg",
        places.site("latitude_deg"),
        "degrees, positive north of the equator",
        f"write latitude_deg = {-latitude:.6g}",
    )


def _latitude_value(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, reading.LatitudeValue)
    latitude, sign = math.degrees(campaign.site.latitude), 1 if found.mistake.north else -1
    actual = sign * round(max(0.0, math.degrees(sign * found.size)))
    return Issue(
        f"the gyros show the Earth rate at a latitude of about {actual} deg{_uncertainty(found)}, "
        f"not {latitude:.6g} deg",
        places.site("latitude_deg"),
        "degrees, positive north of the equator",
        f"write latitude_deg = {actual}, as exactly as it is known",
    )


def _channels(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, outputs.ChannelsExchanged)
    pairs = [(campaign.channels[a].name, campaign.channels[b].name) for a, b in
             zip(mistake.places, mistake.order, strict=True)]  # fmt: skip
    columns = ", ".join(f"'{name}'" for name, _ in pairs)
    return Issue(
        f"channels {columns} are exchanged {subject_of(mistake)}",
        places.column(mistake, pairs[0][0]),
        "every channel in its own column, with its own input_axis",
        "rename the columns: " + ", ".join(f"'{a}' holds '{b}'" for a, b in pairs),
    )


def _unit_and_factor(found: Explanation) -> tuple[str, float]:
    """Return the mistaken unit in words, empty for a reversed sign, and by how much the outputs are too large."""
    if isinstance(found.mistake, reading.ChannelGain):
        return found.mistake.units, found.mistake.factor
    assert isinstance(found.mistake, reading.NominalScale)
    factor = float(f"{math.exp(found.size):.4g}")
    return found.mistake.units(found.size) or f"{factor:g} times its nominal scale", factor


def _about(campaign: Campaign, found: Explanation) -> str:
    """Return the offsets that a change of outputs leaves as they are; empty without any."""
    mistake = found.mistake
    assert isinstance(mistake, (reading.ChannelGain, reading.NominalScale))
    gain = isinstance(mistake, reading.ChannelGain)
    offsets = mistake.offsets if gain else tuple(campaign.channels[place].offset for place in mistake.places)
    return f", each less its offset, {', '.join(f'{each:g}' for each in offsets)}" if any(offsets) else ""


def with_scale(campaign: Campaign, found: Explanation) -> Campaign:
    """Return the campaign with the scale factors that a mistake asks for.

    The line of the next mistake of the same channels starts from them, and so holds the product.
    """
    mistake = found.mistake
    if not isinstance(mistake, (reading.ChannelGain, reading.NominalScale)) or mistake.scope.section == "run":
        return campaign
    units, factor = _unit_and_factor(found)
    channels = tuple(
        replace(each, scale=each.scale * factor) if units and each.name in mistake.channels else each
        for each in campaign.channels
    )
    return replace(campaign, channels=channels)


def _gain(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, (reading.ChannelGain, reading.NominalScale))
    units, factor = _unit_and_factor(found)
    subject, names = subject_of(mistake), ", ".join(f"'{name}'" for name in mistake.channels)
    noun, verb = ("channel", "is") if len(mistake.channels) == 1 else ("channels", "are")
    run = mistake.scope.section == "run"
    chosen = [channel for channel in campaign.channels if channel.name in mistake.channels]
    key = "scale" if units else "input_axis"
    where = places.column(mistake, mistake.channels[0]) if run else places.line("channel", mistake.channels[0], key)
    if not units:
        axes = "; ".join(f"input_axis = {(-c.axes[0].round(6) + 0.0).tolist()} for '{c.name}'" for c in chosen)
        return Issue(
            f"{noun} {names} {verb} reversed in sign {subject}", where,
            "outputs that rise with the input along input_axis",
            f"reverse the sign of the columns {names} {subject}{_about(campaign, found)}" if run
            else f"write {axes} (and reverse output_axis)",
        )  # fmt: skip
    scales = "; ".join(f"scale = {c.scale * factor:.6g} for '{c.name}'" for c in chosen)
    large = factor > 1
    size = f"{factor if large else 1 / factor:.4g} times too {'large' if large else 'small'}"
    return Issue(
        f"{noun} {names} {verb} {size} {subject} ({units})", where,
        "outputs in 'output_unit', 'scale' of them per 'per'",
        f"divide the columns {names} by {factor:.6g} {subject}{_about(campaign, found)}" if run
        else f"write {scales}, or correct 'per', or divide the columns by {factor:.6g}",
    )  # fmt: skip


def _rate(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    if isinstance(found.mistake, reading.TableRates):
        return Issue(
            f"the rates of table '{found.mistake.scope.name}' are {math.exp(found.size):.4g} times those of column "
            "'table_rate_deg_s'",
            places.column(found.mistake, "table_rate_deg_s"),
            "degrees per second",
            f"multiply 'table_rate_deg_s' by {math.exp(found.size):.4g} {subject_of(found.mistake)}",
        )
    return _unit(campaign, found, places)


def _unit(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, (reading.RateUnit, reading.AngleUnit))
    column, units, allowed = "table_angle_deg", reading.ANGLE_UNITS, "degrees"
    if isinstance(mistake, reading.RateUnit):
        column, units, allowed = "table_rate_deg_s", reading.RATE_UNITS, "degrees per second"
    factor = units[mistake.unit]
    return Issue(
        f"column '{column}' is in {mistake.unit} {subject_of(mistake)}",
        places.column(mistake, column),
        allowed,
        f"multiply '{column}' by {factor:.10g} {subject_of(mistake)}",
    )


def _time(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    subject, runs = subject_of(found.mistake), {run.name: run for run in campaign.runs}
    assert isinstance(found.mistake, bench.TimeShift)
    run, size = runs.get(found.mistake.scope.name), float(round(found.size))
    if not found.mistake.whole:
        size = round(2 * found.size) / 2
    seconds = ""
    if run is not None and "time" in run.covariates and run.rows > 1:
        seconds = f" ({abs(size) * float(np.median(np.diff(run.covariates['time']))):.3g} s)"
    sense = "later" if found.size > 0 else "earlier"
    return Issue(
        f"the outputs are {abs(size):g} rows{seconds} {sense} than the columns of the table {subject}",
        places.column(found.mistake, "time_s"),
        "outputs and table recorded on one clock",
        f"shift the outputs by {-size:+g} rows{seconds} against the columns of the table {subject}",
    )


def _axis(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, seats.InputAxisWrong)
    channel, axis = campaign.channels[found.mistake.channel], found.mistake.axes.round(6)
    stated = (channel.axes[0].round(6) + 0.0).tolist()
    return Issue(
        f"channel '{channel.name}' responds along {(axis[0] + 0.0).tolist()}, not along its input_axis {stated}",
        places.line("channel", channel.name, "input_axis"),
        "the axis of the body along which the output rises",
        f"write input_axis = {(axis[0] + 0.0).tolist()} for '{channel.name}', and output_axis = "
        f"{(axis[1] + 0.0).tolist()} or as it is",
    )


REMEDIES: dict[str, Callable[[Campaign, Explanation, Places], Issue]] = RECORD_REMEDIES | {
    "latitude_sign": _latitude,
    "latitude_value": _latitude_value,
    "files_exchanged": _files,
    "mounting_mislabelled": _label,
    "mountings_exchanged": _seats,
    "table_reversed": _sense,
    "table_zero": _zero,
    "axis_zero": _axis_zero,
    "axis_reversed": _axis_sense,
    "axis_columns": _axis_columns,
    "mounting_turned": _turned,
    "table_elevation": _elevation,
    "table_azimuth": _azimuth,
    "axes_exchanged": _channels,
    "channel_unit": _gain,
    "rate_unit": _rate,
    "angle_unit": _unit,
    "time_shift": _time,
    "mounting_wrong": _matrix,
    "input_axis_wrong": _axis,
}
"""Kind of mistake → how it is said."""
