"""The command `imubayes`: the table of commands, and the way from an error to four lines and an exit status."""

import gc
import os
import sys
from collections.abc import Sequence

import cyclopts

from imubayes import __version__
from imubayes.cli.add import add
from imubayes.cli.carrier import carrier
from imubayes.cli.check import check
from imubayes.cli.classical import classical
from imubayes.cli.compare import compare
from imubayes.cli.convert import convert
from imubayes.cli.diagnose import diagnose
from imubayes.cli.effects import effects
from imubayes.cli.fit import fit
from imubayes.cli.history import history
from imubayes.cli.plant import plant
from imubayes.cli.schema import schema
from imubayes.cli.simulate import simulate
from imubayes.errors import InputError, Issue, closest_first

DONE, NO, UNUSABLE, INTERRUPTED = 0, 1, 2, 130
_RARELY = 100_000
_COMMANDS = (
    check, fit, compare, classical, carrier, diagnose, add, history, plant, effects, simulate, convert, schema
)  # fmt: skip

app = cyclopts.App(
    name="imubayes",
    version=__version__,
    help="Bayesian calibration and uncertainty for inertial sensors.\n\n"
    "Example: imubayes fit data/trihedral-imu --model models/trihedral-imu.toml --out results/trihedral-imu",
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
for _command in _COMMANDS:
    app.command(_command)


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command and leave with its exit status: 0 done, 1 the answer is no, 2 unusable input."""
    # A command imports and traces a million objects that live to its end: looking through them again and again for
    # what could be freed takes half a second of every start.
    gc.set_threshold(_RARELY)
    sys.exit(run(arguments))


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status."""
    try:
        status = app(arguments, exit_on_error=False, print_error=False)
    except InputError as error:
        return _refuse(*error.issues)
    except cyclopts.CycloptsError as error:
        return _refuse(_of_command_line(error))
    except KeyboardInterrupt:
        print("interrupted; what `imubayes fit` has sampled so far is kept, and --resume goes on", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        return DONE
    except Exception as error:
        if os.environ.get("IMUBAYES_TRACEBACK"):
            raise
        return _refuse(_of_file(error) if isinstance(error, OSError) and error.filename else _unforeseen(error))
    return status if isinstance(status, int) else DONE


def _refuse(*issues: Issue) -> int:
    print("\n\n".join(str(problem) for problem in issues), file=sys.stderr)
    if len(issues) > 1:
        print(f"\n{len(issues)} problems found; nothing was written", file=sys.stderr)
    return UNUSABLE


def _of_command_line(error: cyclopts.CycloptsError) -> Issue:
    names = [command.__name__ for command in _COMMANDS]
    words = [word for word in (getattr(error, "unused_tokens", None) or []) if isinstance(word, str)]
    known = words[0] if words else ""
    allowed = closest_first(known, names) if isinstance(error, cyclopts.UnknownCommandError) else "see --help"
    return Issue(
        str(error).strip().splitlines()[0], "command line", allowed, "imubayes COMMAND --help shows an example"
    )


def _of_file(error: OSError) -> Issue:
    return Issue(
        f"the file system refuses: {error.strerror or error}",
        str(error.filename2 or error.filename),
        "a place that can be read, or written where something is to be written there",
        "choose another place, or mend its permissions",
    )


def _unforeseen(error: Exception) -> Issue:
    return Issue(
        f"an unforeseen fault: {type(error).__name__}: {error}",
        "inside imubayes",
        "",
        "set IMUBAYES_TRACEBACK=1, run the command again and report what it prints",
    )


if __name__ == "__main__":
    main()
