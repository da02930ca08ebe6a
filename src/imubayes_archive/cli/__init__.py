"""The commands of this package: `imubayes archive` and `imubayes batch`."""

from imubayes.cli.registration import Command
from imubayes_archive.cli.batch import archive, batch

_UNITS_KEPT = "the units fitted so far are kept, the same command continues"
COMMANDS = (Command(archive, "Many units", 0), Command(batch, "Many units", 1, interrupted=_UNITS_KEPT))
