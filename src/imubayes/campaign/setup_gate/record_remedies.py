"""How mistakes in the record of a run are said, and the line to write instead.

A wrong value is said as the fit and the diagnosis say it (`foundations.wrong_records`).
"""

import math
from collections.abc import Callable

import numpy as np

from imubayes.campaign.setup_gate import thermal_mistakes as thermal
from imubayes.campaign.setup_gate.explanations import Explanation
from imubayes.campaign.setup_gate.file_mistakes import OutputsExchanged
from imubayes.campaign.setup_gate.output_mistakes import ChannelApart, ChannelOffset, repeats
from imubayes.campaign.setup_gate.places import Places, subject_of
from imubayes.campaign.setup_gate.rate_records import RatesExchanged, RatesMissing, RateWithoutSign, ReferenceUnit
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import Issue
from imubayes.foundations.number_text import pretty
from imubayes.foundations.wrong_records import WrongRecord, agreement_text, correction

_MOST_ROWS = 12
_COLUMN = {"temperature": "temperature_degC", "converter_temperature": "converter_temperature_degC"}


def _thermal_columns(
    mistake: thermal.TemperatureUnit | thermal.TemperatureReversed | thermal.TemperatureValue,
) -> tuple[str, str, bool]:
    """Return the columns of a mistake as a list, the noun before it, and whether it is one."""
    one = len(mistake.names) == 1
    return " and ".join(f"'{_COLUMN[name]}'" for name in mistake.names), "column" if one else "columns", one


def _thermometers(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    return Issue(
        f"columns 'temperature_degC' and 'converter_temperature_degC' are exchanged {subject_of(found.mistake)}",
        places.column(found.mistake, _COLUMN["temperature"]),
        "the temperature of the sensors, and that of the converter",
        f"exchange the names of the two columns {subject_of(found.mistake)}",
    )


def _backwards(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, thermal.TemperatureReversed)
    mistake = found.mistake
    columns, noun, one = _thermal_columns(mistake)
    return Issue(
        f"{noun} {columns} {'runs' if one else 'run'} backwards in time {subject_of(mistake)}",
        places.column(mistake, _COLUMN[mistake.names[0]]),
        "temperatures in the order of the rows",
        f"reverse the order of {noun} {columns} {subject_of(mistake)}",
    )


def _apart(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, ChannelApart)
    run, name = mistake.scope.name, mistake.channel
    like = repeats(campaign, next(k for k, each in enumerate(campaign.runs) if each.name == run), mistake.place)
    how = (
        "hold one value" if like == name else f"repeat those of channel '{like}'" if like else "do not follow the input"
    )
    return Issue(
        f"the outputs of channel '{name}' {how} in run '{run}'",
        places.column(mistake, name),
        "the outputs of the channel itself in that run",
        f"record the outputs of '{name}' in run '{run}' again, or leave its cells in {places.file(run)} empty",
    )


def _unsigned(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, RateWithoutSign)
    rows = [str(k + 1) for k in np.flatnonzero(found.mistake.signs < 0)]
    listed = ", ".join(rows[:_MOST_ROWS]) + (" and others" if len(rows) > _MOST_ROWS else "")
    return Issue(
        f"the rates {subject_of(found.mistake)} are recorded without their sign: the gyros turn the other way in "
        f"{len(rows)} of {len(found.mistake.signs)} rows",
        places.column(found.mistake, "table_rate_deg_s"),
        "rates right-handed about the axis of the table, with their sign",
        f"reverse the sign of 'table_rate_deg_s' in rows {listed} of {places.file(found.mistake.scope.name)}",
    )


def _offset(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, ChannelOffset)
    mistake = found.mistake
    channel = campaign.channels[mistake.place]
    right = f"{channel.offset + found.size * mistake.largest:.5g}"
    return Issue(
        f"the outputs of channel '{mistake.channel}' lie about {right} {pretty(channel.output_unit)} in all runs, not "
        f"about its offset, {channel.offset:g}",
        places.line("channel", mistake.channel, "offset"),
        "the output without input",
        f"write offset = {right} for '{mistake.channel}', as exactly as it is known",
    )


def _swapped(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, RatesExchanged)
    mistake, file = found.mistake, places.file(found.mistake.scope.name)
    rows = [str(row + 1) for row in mistake.rows]
    listed = " and ".join(rows) if len(rows) == 2 else ", ".join(rows)
    what = "of all rows are in reverse order" if mistake.reverse else f"of rows {listed} are exchanged"
    sources = ", ".join(str(mistake.order[row] + 1) for row in mistake.rows)
    mend = f"exchange 'table_rate_deg_s' of rows {listed} of {file}"
    if mistake.reverse:
        mend = f"reverse the order of 'table_rate_deg_s' in {file}"
    elif len(rows) > 2:
        mend = f"write 'table_rate_deg_s' of rows {sources} in rows {listed} of {file}"
    return Issue(
        f"the rates {what} {subject_of(mistake)}",
        places.column(mistake, "table_rate_deg_s"),
        "the rate of the table in the row itself",
        mend,
    )


def _outputs(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, OutputsExchanged)
    first, second = found.mistake.scope.name, found.mistake.second
    return Issue(
        f"the outputs of runs '{first}' and '{second}' are exchanged, and the columns of the bench are not",
        f"{places.table(first)} and {places.table(second)}",
        "outputs beside the columns of the bench of the same run",
        f"exchange the columns of all channels between {places.file(first)} and {places.file(second)}",
    )


def _reference(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, ReferenceUnit)
    mistake, subject = found.mistake, subject_of(found.mistake)
    columns = [f"'reference_{'xyz'[axis]}_deg_s'" for axis in mistake.axes]
    listed, many = ", ".join(columns), len(columns) > 1
    what, mend = "reversed in sign", f"reverse the sign of {listed}"
    if mistake.unit:
        what, mend = f"in {mistake.unit}", f"multiply {listed} by {mistake.factor:.8g}"
    elif mistake.factor == 1:
        what, mend = "exchanged", f"exchange the names of the columns {listed}"
    return Issue(
        f"{'columns' if many else 'column'} {listed} {'are' if many else 'is'} {what} {subject}",
        places.column(mistake, columns[0].strip("'")),
        "rates of the reference gyro in axes of the body, degrees per second",
        f"{mend} {subject}",
    )


def _no_rates(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, RatesMissing)
    largest = max(float(np.abs(each).max()) for each in found.mistake.rates)
    many = len(found.mistake.rates)
    named = subject_of(found.mistake) if many == 1 else f"in {many} runs"
    return Issue(
        f"column 'table_rate_deg_s' is zero {named}, and the gyros turn by up to {math.degrees(largest):.4g} deg/s",
        places.column(found.mistake, "table_rate_deg_s"),
        "the rate of the table in each row",
        "record the rates of the table in 'table_rate_deg_s'",
    )


_ALLOWED = {
    "offset": "the value that the unit, or the table, had in the run",
    "factor": "the rate that the table had in the run",
    "output_offset": "outputs with the bias of the other runs",
    "output_factor": "outputs in 'output_unit', 'scale' of them per 'per'",
    "exchange": "the values of the run itself",
    "unit": "runs of one unit",
    "samples": "the number of raw samples of each row",
}


def issue_of(found: Explanation, record: WrongRecord, places: Places) -> Issue:
    """Return what is wrong in the record of a run as an issue."""
    where = places.column(found.mistake, record.quantity.split(" and ")[0])
    if record.quantity == "outputs":
        where = places.table(record.run)
    if record.form == "unit":
        where = places.line("run", record.run, "file")
    if record.other:
        where += f", and {places.table(record.other)}"
    what = f"run '{record.run}' would agree with the other runs given {agreement_text(record)}"
    return Issue(what, where, _ALLOWED[record.form], correction(record))


RECORD_REMEDIES: dict[str, Callable[[Campaign, Explanation, Places], Issue]] = {
    "thermometers_exchanged": _thermometers,
    "temperature_reversed": _backwards,
    "outputs_apart": _apart,
    "outputs_exchanged": _outputs,
    "output_offset": _offset,
    "rate_without_sign": _unsigned,
    "rates_missing": _no_rates,
    "reference_unit": _reference,
    "rates_exchanged": _swapped,
}
"""Kind of mistake → how it is said."""
