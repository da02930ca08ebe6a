"""The commands of this package: `imubayes archive` and `imubayes batch`."""

from imubayes.cli.registration import Command

_UNITS_KEPT = "the units fitted so far are kept, the same command continues"
COMMANDS = (
    Command("imubayes_archive.cli.batch:archive", "Many units", 0),
    Command("imubayes_archive.cli.batch:batch", "Many units", 1, interrupted=_UNITS_KEPT),
)
