"""Thermometers that runs share, and the other instruments, of `campaign.toml` as records."""

from collections.abc import Mapping

from imubayes.campaign.equipment import RunReferences, refuse_repeats
from imubayes.campaign.file_schemas import InstrumentsEntry, ThermometerEntry
from imubayes.campaign.toml_documents import Ledger
from imubayes.foundations.campaign_data import Instruments, Thermometer
from imubayes.foundations.units import to_si


def build_thermometers(entries: Mapping[int, ThermometerEntry], ledger: Ledger) -> dict[str, Thermometer]:
    """Return the thermometers by name."""
    refuse_repeats({index: entry.name for index, entry in entries.items()}, "thermometer", ledger)
    return {
        entry.name: Thermometer(
            entry.name, entry.offset_uncertainty_degC, _ratio(entry.gain_uncertainty_percent, to_si("%"))
        )
        for entry in entries.values()
    }


def build_instruments(entry: InstrumentsEntry) -> Instruments:
    """Return the uncertainties of clock, vibration sensor, time base and meter."""
    return Instruments(
        _ratio(entry.clock_uncertainty_ppm, to_si("ppm")),
        _ratio(entry.vibration_uncertainty_percent, to_si("%")),
        _ratio(entry.time_base_uncertainty_ppm, to_si("ppm")),
        _ratio(entry.meter_uncertainty_ppm, to_si("ppm")),
    )


def _ratio(value: float | None, unit: float) -> float | None:
    return None if value is None else value * unit


def refuse_two_readings(runs: Mapping[int, RunReferences], ledger: Ledger) -> None:
    """Add an issue for a thermometer that reads the sensors in one run, and the converter in the same or another.

    The two temperatures have an error each.
    """
    of_sensors = {run.thermometer: run.name for run in runs.values() if run.thermometer is not None}
    for index, run in runs.items():
        if run.converter_thermometer in of_sensors:
            ledger.add(
                f"'{run.converter_thermometer}' is the converter_thermometer of run '{run.name}', and the thermometer "
                f"of run '{of_sensors[run.converter_thermometer]}'",
                ("run", index, "converter_thermometer"),
                "a thermometer that reads either the temperature of the sensors or that of the converter",
                "add a [[thermometer]] for each of the two",
            )
