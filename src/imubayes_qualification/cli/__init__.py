"""The commands of this package: what is done with a fitted unit, and the answers that are known."""

from imubayes.cli.registration import Command
from imubayes_qualification.cli.calibrated_unit import apply, carrier, export, mission, report
from imubayes_qualification.cli.selftest import selftest

COMMANDS = (
    *(Command(call, "Results", place) for place, call in enumerate((report, apply, export, mission))),
    Command(carrier, "Data", 4),
    Command(selftest, "Data", 8),
)
