"""All mistakes of a set-up, from the most to the least usual.

Of those that explain the outputs equally well the first is named.  A new mistake is its class, its place here, its
words in `remedies` or `record_remedies`, and its name in `campaign.stream_checks`.
"""

from imubayes.campaign.setup_gate.axis_mistakes import AxisColumns, AxisSense, AxisZero
from imubayes.campaign.setup_gate.equipment_mistakes import (
    FilesExchanged,
    Mistake,
    MountingTurned,
    TableAzimuth,
    TableElevation,
    TableSense,
    TableZero,
    TimeShift,
)
from imubayes.campaign.setup_gate.file_mistakes import OtherUnit, OutputsExchanged, SamplesFewer
from imubayes.campaign.setup_gate.mounting_mistakes import (
    InputAxisAngles,
    InputAxisWrong,
    MountingAngles,
    MountingMislabelled,
    MountingsExchanged,
    MountingWrong,
)
from imubayes.campaign.setup_gate.output_mistakes import (
    ChannelApart,
    ChannelOffset,
    ChannelsExchanged,
    KindsExchanged,
    OffsetsMissing,
)
from imubayes.campaign.setup_gate.rate_records import RatesExchanged, RatesMissing, RateWithoutSign, ReferenceUnit
from imubayes.campaign.setup_gate.reading_mistakes import (
    AngleUnit,
    ChannelGain,
    LatitudeSign,
    LatitudeValue,
    NominalScale,
    RateUnit,
    TableRates,
)
from imubayes.campaign.setup_gate.thermal_mistakes import (
    TemperatureReversed,
    TemperaturesExchanged,
    TemperatureUnit,
    TemperatureValue,
    ThermometersExchanged,
)
from imubayes.campaign.setup_gate.wrong_rows import RateFactor

MISTAKES: tuple[type[Mistake], ...] = (
    FilesExchanged, MountingMislabelled, MountingsExchanged, TableSense, TableZero, MountingTurned,
    TableElevation, TableAzimuth, ChannelsExchanged, KindsExchanged, TimeShift, MountingWrong, InputAxisWrong,
    AxisZero, AxisSense, AxisColumns, ReferenceUnit, ChannelGain, RateUnit, AngleUnit, NominalScale, TableRates,
    RateFactor, MountingAngles, InputAxisAngles,
    LatitudeSign, LatitudeValue,
    ThermometersExchanged, TemperaturesExchanged, TemperatureUnit, TemperatureReversed, TemperatureValue,
    RateWithoutSign, RatesExchanged, RatesMissing, OutputsExchanged, OffsetsMissing, ChannelOffset, ChannelApart,
    OtherUnit, SamplesFewer,
)  # fmt: skip
