"""The commands of this package: `imubayes archive` and `imubayes batch`."""

from imubayes.cli.registration import Command
from imubayes_archive.cli.batch import archive, batch

COMMANDS = (Command(archive, "Many units", 0), Command(batch, "Many units", 1))
