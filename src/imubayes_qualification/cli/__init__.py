"""The commands of this package: what is done with a fitted unit, and the answers that are known."""

from imubayes.cli.registration import Command

COMMANDS = (
    Command("imubayes_qualification.cli.calibrated_unit:report", "Results", 0),
    Command("imubayes_qualification.cli.calibrated_unit:apply", "Results", 1),
    Command("imubayes_qualification.cli.calibrated_unit:export", "Results", 2),
    Command("imubayes_qualification.cli.calibrated_unit:mission", "Results", 3),
    Command("imubayes_qualification.cli.calibrated_unit:carrier", "Data", 4),
    Command("imubayes_qualification.cli.selftest:selftest", "Data", 8),
)
