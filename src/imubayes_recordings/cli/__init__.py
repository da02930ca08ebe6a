"""The commands of this package: recordings that become campaigns, and the noise of static records."""

from imubayes.cli.registration import Command

# The options of the first three are those of a dataclass that takes long to import, and their help stands here.
COMMANDS = (
    Command(
        "imubayes_recordings.cli.convert:new", "Data", -2, "new",
        "Begin: write a commented campaign from a recording, and a model with the effects that its runs can "
        "determine.\n\n"
        "Example: imubayes new campaigns/desk imu.csv --gravity-m-s2 9.81",
    ),
    Command(
        "imubayes_recordings.cli.convert:convert", "Data", -1, "convert",
        "Convert a recording of any format into a campaign folder.\n\n"
        "Example: imubayes convert acc.mat gyro.mat --out campaigns/xsens --accel-unit count --gyro-unit count "
        "--gravity-m-s2 9.81744",
    ),
    Command(
        "imubayes_recordings.cli.capture:capture", "Data", -0.5, "capture",
        "Record a unit turned by hand, with instructions, until poses or motions determine the requested "
        "quantities.\n\n"
        "Example: imubayes capture campaigns/desk --from port.log --until accel_bias=0.2mg --gravity-m-s2 9.81; "
        "cat /dev/ttyUSB0 | imubayes capture campaigns/desk --from - --gravity-m-s2 9.81",
    ),
    Command("imubayes_recordings.cli.noise:noise", "Data", 2),
)  # fmt: skip
