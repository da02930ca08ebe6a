"""`imubayes capture`: a recording that is taken step by step, with what the poses determine so far."""

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from imubayes.cli.session import Names, split
from imubayes_recordings.cli.convert import NO_OPTIONS, Options, option_name, stated
from imubayes_recordings.display.capture_lines import now_line, plan_lines, rest_line
from imubayes_recordings.guided_capture import Guidance, Motion, Wanted


def capture(
    folder: Path,
    *,
    source: Annotated[Path, Parameter(name="--from", allow_leading_hyphen=True)],
    until: Names = None,
    motion: Motion = "poses",
    seconds: float | None = None,
    patience: float = 60.0,
    column: Annotated[list[str] | None, Parameter(negative="")] = None,
    options: Annotated[Options, Parameter(name="*", negative="", name_transform=option_name)] = NO_OPTIONS,
) -> int:
    """Record a unit turned by hand, with instructions until poses or motions determine the requested quantities.

    The exit status is 1 if the recording ended before. Ctrl-C ends it: the campaign is written with what there is.

    Parameters
    ----------
    folder
        Campaign folder to write.
    source
        A text file that grows, or - for lines of standard input; these are kept in FOLDER.log until the campaign is
        written.
    until
        EFFECT=UNCERTAINTY, the largest permitted standard uncertainties; by default accel_bias=0.3mg
        accel_scale_factor=300ppm accel_misalignment=2arcmin gyro_bias=20deg/h gyro_scale_factor=0.1%
        gyro_misalignment=4arcmin. The defaults of --motion are larger (see the manual).
    motion
        poses, held at rest; drill, turns about one axis after the other on a drill, a wheel or a chair on its side;
        wave, moved slowly by hand without rests.
    seconds
        Duration of each motion: 20 for a drill, 60 for waving by default.
    patience
        Seconds without a line after which a file is taken to have ended.
    column
        COLUMN=SOURCE, once for each column that has a different name; see convert.
    """
    from imubayes_recordings.api.capture import capture as guided

    screen = _Screen()
    given = stated(options, column)
    made = guided(folder, str(source), split(until) or None, motion=motion, seconds=seconds, patience=patience,
                  show=screen.show, **given)  # fmt: skip
    done = made.last.state == "done"
    print(f"campaign in {made.folder}; next: imubayes new {made.folder}")
    return 0 if done else 1


class _Screen:
    """A line that changes on a terminal; a line for each rest everywhere."""

    def __init__(self) -> None:
        self._moving, self._said, self._faults = sys.stdout.isatty(), "", ""

    def show(self, step: Guidance, wanted: Sequence[Wanted]) -> None:
        """Show a step."""
        if step.state == "plan":
            print("\n".join(plan_lines(step)), flush=True)
        elif step.fault and step.fault.split(":")[0] != self._faults and not self._moving:
            print(now_line(step), flush=True)  # once for each kind of fault
            self._faults = step.fault.split(":")[0]
        elif step.state in ("enough", "done", "ended"):
            line = rest_line(step, wanted)
            if line != self._said:
                print(f"\r\x1b[2K{line}" if self._moving else line, flush=True)
            self._said = line
        elif self._moving:
            print(f"\r\x1b[2K{now_line(step)}", end="", flush=True)
