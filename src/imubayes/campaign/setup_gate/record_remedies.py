"""How mistakes in the recorded temperatures, rates and files are said, and the line to write instead."""

import math
from collections.abc import Callable

import numpy as np

from imubayes.campaign.setup_gate import thermal_mistakes as thermal
from imubayes.campaign.setup_gate.output_mistakes import ChannelApart, ChannelOffset, repeats
from imubayes.campaign.setup_gate.places import Places, subject_of
from imubayes.campaign.setup_gate.rate_records import RatesExchanged, RatesMissing, RateWithoutSign
from imubayes.campaign.setup_gate.search import Explanation
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import Issue

_MOST_ROWS = 12
_COLUMN = {"temperature": "temperature_degC", "converter_temperature": "converter_temperature_degC"}


def _fahrenheit(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, thermal.TemperatureUnit)
    columns, noun, one = _thermal_columns(mistake)
    return Issue(
        f"{noun} {columns} {'is' if one else 'are'} in degrees Fahrenheit {subject_of(mistake)}",
        places.column(mistake, _COLUMN[mistake.names[0]]),
        "degrees Celsius",
        f"replace T by (T - 32) / 1.8 in {columns} {subject_of(mistake)}",
    )


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


def _temperature(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, thermal.TemperatureValue)
    run = next(run for run in campaign.runs if run.name == mistake.scope.name)
    recorded = float(np.mean(run.covariates[mistake.names[0]]))
    columns, noun, _ = _thermal_columns(mistake)
    sd = f" ± {found.uncertainty:.1g}" if found.uncertainty else ""
    return Issue(
        f"the outputs of run '{run.name}' are as at a mean temperature of {recorded + found.size:.1f}{sd} °C, recorded "
        f"{recorded:.1f}",
        places.column(mistake, _COLUMN[mistake.names[0]]),
        "the temperature that the unit had",
        f"state the temperature as it was: {found.size:+.1f} °C would agree in {noun} {columns} {subject_of(mistake)}",
    )


def _temperatures(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, thermal.TemperaturesExchanged)
    first, second = mistake.scope.name, mistake.second
    return Issue(
        f"the temperatures of runs '{first}' and '{second}' are exchanged",
        f"{places.column(mistake, _COLUMN['temperature'])}, and {places.table(second)}",
        "the temperatures of the run itself",
        f"exchange column '{_COLUMN['temperature']}' of {places.file(first)} and {places.file(second)}",
    )


def _other_unit(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    run = found.mistake.scope.name
    return Issue(
        f"run '{run}' is of another unit: scale factors, axes and biases of all its channels are unlike those of the "
        "other runs",
        places.line("run", run, "file"),
        "runs of one unit",
        f"name the file of this unit for run '{run}', or leave the run out",
    )


def _offset(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    mistake = found.mistake
    assert isinstance(mistake, ChannelOffset)
    channel, run = campaign.channels[mistake.place], mistake.scope.name
    digits = max(2, 1 + math.floor(math.log10(abs(found.size) / found.uncertainty))) if found.uncertainty else 4
    size = f"{found.size * mistake.largest:+.{min(digits, 9)}g}"
    sd = f" ± {found.uncertainty * mistake.largest:.1g}" if found.uncertainty else ""
    return Issue(
        f"the outputs of channel '{channel.name}' are off by {size}{sd} {channel.output_unit} in run '{run}', in all "
        "rows alike",
        places.column(mistake, channel.name),
        "outputs with the bias of the other runs",
        f"subtract {size} from column '{channel.name}' of {places.file(run)} if its zero was moved, or leave the run "
        "out",
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


def _swapped(campaign: Campaign, found: Explanation, places: Places) -> Issue:
    assert isinstance(found.mistake, RatesExchanged)
    one, other = (row + 1 for row in found.mistake.rows)
    return Issue(
        f"the rates of rows {one} and {other} are exchanged {subject_of(found.mistake)}",
        places.column(found.mistake, "table_rate_deg_s"),
        "the rate of the table in the row itself",
        f"exchange 'table_rate_deg_s' of rows {one} and {other} of {places.file(found.mistake.scope.name)}",
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


RECORD_REMEDIES: dict[str, Callable[[Campaign, Explanation, Places], Issue]] = {
    "temperature_unit": _fahrenheit,
    "thermometers_exchanged": _thermometers,
    "temperature_reversed": _backwards,
    "temperature_value": _temperature,
    "temperatures_exchanged": _temperatures,
    "other_unit": _other_unit,
    "output_offset": _offset,
    "outputs_apart": _apart,
    "rate_without_sign": _unsigned,
    "rates_missing": _no_rates,
    "rates_exchanged": _swapped,
}
"""Kind of mistake → how it is said."""
