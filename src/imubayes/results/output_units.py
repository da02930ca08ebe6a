"""Quantities in output units as they are shown: in the unit of their channel."""

from imubayes.campaign.servo_angle import ANGLE, ANGLE_UNIT
from imubayes.results.summary import Quantity, Summary
from imubayes.units import with_output_unit


def channel_units(summary: Summary) -> dict[str, tuple[str, str]]:
    """Return the units of output and input of each channel, which its scale factor has."""
    scales = [entry for entry in summary.derived if entry.name.startswith("scale_factor[")]
    parts = [(entry.name[len("scale_factor[") : -1], entry.unit.rpartition(" per ")) for entry in scales]
    return {channel: (output, per) for channel, (output, _, per) in parts}


def in_output_units(summary: Summary) -> Summary:
    """Return a summary whose parameters have the output units of their channels in place of `output`.

    What belongs to channels of different output units keeps it.
    """
    units = {channel: output for channel, (output, _) in channel_units(summary).items()}
    common = next(iter(units.values())) if len(set(units.values())) == 1 else ""

    units[ANGLE] = ANGLE_UNIT

    def shown[Line: Quantity](line: Line, name: str) -> Line:
        label = name.partition("[")[2].removesuffix("]").split(",")
        output = next((units[part] for part in label if part in units), common)
        return line.model_copy(update={"unit": with_output_unit(line.unit, output)})

    combinations = tuple(shown(line, line.quantities[0]) for line in summary.combinations)
    own = {line.name: line.unit for line in combinations}
    return summary.model_copy(
        update={
            "parameters": tuple(shown(line, line.name) for line in summary.parameters),
            "combinations": combinations,
            "contributions": tuple(
                each.model_copy(update={"unit": own.get(each.quantity, each.unit)}) for each in summary.contributions
            ),
        }
    )
