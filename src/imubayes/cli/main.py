"""The command `imubayes`: its subcommands, error messages and exit status."""

import atexit
import errno
import gc
import io
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import chain
from pathlib import Path
from typing import Any, NoReturn

import cyclopts

from imubayes import __version__
from imubayes.cli.registration import GROUPS, Command
from imubayes.cli.session import numbers_apart
from imubayes.foundations.errors import InputError, Issue, NotKept, closest_first
from imubayes.foundations.extensions import extensions

DONE, UNUSABLE, INTERRUPTED = 0, 2, 130
_FULL = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
# Characters that steer a terminal: they come from names in files, and are shown as numbers.
_CONTROL = {code: f"\\x{code:02x}" for code in (*range(9), *range(11, 32), *range(127, 160))}
_COLLECTION_THRESHOLD = 2_000_000
_SAMPLES_KEPT = "the samples so far are kept, --resume continues"
_COMMANDS = (
    Command("imubayes.cli.examples:demo", "The loop", 0),
    Command("imubayes.cli.fit:fit", "The loop", 1, interrupted=_SAMPLES_KEPT),
    Command("imubayes.cli.fit:compare", "The loop", 2),
    Command("imubayes.cli.fit:predict", "The loop", 3),
    Command("imubayes.cli.loop:diagnose", "The loop", 4),
    Command("imubayes.cli.loop:add", "The loop", 5),
    Command("imubayes.cli.loop:remove", "The loop", 6),
    Command("imubayes.cli.loop:refit", "The loop", 7),
    Command("imubayes.cli.loop:history", "The loop", 8),
    Command("imubayes.cli.loop:plant", "The loop", 10),
    Command("imubayes.cli.examples:example", "Data", 0),
    Command("imubayes.cli.campaign:check", "Data", 1),
    Command("imubayes.cli.fit:classical", "Data", 3),
    Command("imubayes.cli.campaign:effects", "Data", 5),
    Command("imubayes.cli.campaign:simulate", "Data", 6),
    Command("imubayes.cli.campaign:schema", "Data", 7),
)
"""Commands of the kernel; those of the packages beside it have places between them."""

app = cyclopts.App(
    name="imubayes",
    version=__version__,
    help="Bayesian calibration and uncertainty for inertial sensors.\n\n"
    "Begin: imubayes demo\n\n"
    "Example: imubayes fit data/trihedral-imu --model trihedral-imu --out results/trihedral-imu",
    result_action="return_value",
    suppress_keyboard_interrupt=False,
)
_ordered = {name: cyclopts.Group(name, sort_key=place) for place, name in enumerate(GROUPS)}
_beside = chain.from_iterable(entry.load() for entry in extensions("commands").values())
_registered: dict[str, Command] = {}
for _command in chain(_COMMANDS, _beside):
    _command.add_to(app, _ordered[_command.group])
    _registered[_command.word] = _command

app.register_install_completion_command()


def main(arguments: Sequence[str] | None = None) -> None:
    """Run a command and exit with its status: 0 success, 1 negative result, 2 unusable input."""
    # Imports and tracing create a million long-lived objects: garbage collection among them costs half a second.
    gc.set_threshold(_COLLECTION_THRESHOLD)
    # The matrices are small: threads of OpenBLAS wait for each other, on the cores that compiled code needs.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # A terminal that lacks a character shows another one in its place.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")
    _leave(run(arguments))


def _leave(status: int) -> NoReturn:
    """End the process: what is registered for the exit runs, objects are not taken down one by one.

    After a fit that would take a second, for memory that the system takes back at once.
    """
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError):  # a pipe that is closed already
            stream.flush()
    atexit._run_exitfuncs()
    os._exit(status)


def run(arguments: Sequence[str] | None = None) -> int:
    """Run a command and return its exit status."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    try:
        with _telling_what_is_not_kept():
            _import_shown(words)
            status = app(numbers_apart(words), exit_on_error=False, print_error=False)
            sys.stdout.flush()
    except InputError as error:
        return _refuse(*error.issues, written=error.written)
    except cyclopts.CycloptsError as error:
        return _refuse(_of_command_line(error))
    except KeyboardInterrupt:
        kept = _registered[words[0]].interrupted if words and words[0] in _registered else ""
        print(f"interrupted{'; ' if kept else ''}{kept}", file=sys.stderr)
        return INTERRUPTED
    except BrokenPipeError:
        return DONE
    except Exception as error:
        if os.environ.get("IMUBAYES_TRACEBACK"):
            raise
        return _refuse(_issue_of(error))
    return status if isinstance(status, int) else DONE


def _import_shown(words: Sequence[str]) -> None:
    """Import the commands whose help `imubayes --help` takes from their functions, unless a command runs."""
    if not words or words[0] not in _registered:
        for word, command in _registered.items():
            if not command.help:
                app[word]  # resolved by the library, which leaves out the help of others


@contextmanager
def _telling_what_is_not_kept() -> Iterator[None]:
    """Print what could not be kept, one line for each folder, after what a command prints."""
    lines: dict[Path, str] = {}
    try:
        with warnings.catch_warnings():
            others = warnings.showwarning

            def show(message: Warning | str, category: type[Warning], *where: Any) -> None:
                if isinstance(message, NotKept):
                    lines.setdefault(message.folder, f"warning: {message}")
                else:
                    others(message, category, *where)

            warnings.simplefilter("always", NotKept)
            warnings.showwarning = show
            yield
    finally:  # also if the command fails after it
        for line in lines.values():
            print(line.translate(_CONTROL), file=sys.stderr)


def _refuse(*issues: Issue, written: str = "") -> int:
    print("\n\n".join(str(issue) for issue in issues).translate(_CONTROL), file=sys.stderr)
    if len(issues) > 1:
        print(f"\n{len(issues)} problems found", file=sys.stderr)
    if written:
        print(
            f"\nwritten to be corrected: {written}, with its faults at the top of campaign.toml; "
            f"next: imubayes check {written}, then imubayes new {written} for the model",
            file=sys.stderr,
        )
    return UNUSABLE


def _of_command_line(error: cyclopts.CycloptsError) -> Issue:
    names = [name for name in app if not name.startswith("-")]
    words = [word for word in (getattr(error, "unused_tokens", None) or []) if isinstance(word, str)]
    known = words[0] if words else ""
    allowed = closest_first(known, names) if isinstance(error, cyclopts.UnknownCommandError) else "see --help"
    command = " ".join(error.command_chain or ("COMMAND",))
    what = str(error).strip().splitlines()[0]
    if isinstance(error, cyclopts.MissingArgumentError):
        if misspelt := _unknown_option(words):
            what, allowed = f"'{command}' has no option {misspelt}", closest_first(misspelt, _options(error))
        else:
            what = _missing(error, command) or what
    return Issue(what, "command line", allowed, f"imubayes {command} --help shows an example")


def _missing(error: cyclopts.MissingArgumentError, command: str) -> str:
    """Return which argument or option is missing; empty if it is there without a value."""
    argument = error.argument
    if argument is None or error.keyword is not None:
        return ""
    # The library calls a positional argument by the option of the same name.
    positional = argument.field_info.is_positional
    name = argument.name.lstrip("-").upper() if positional else argument.name
    return f"the {'argument' if positional else 'option'} {name} of '{command}' is missing"


def _unknown_option(words: Sequence[str]) -> str:
    """Return the first option that no parameter took; empty if there is none.

    The library looks for missing parameters first: a misspelt option would be reported as missing.
    """
    return next((word.partition("=")[0] for word in words if word.startswith("--")), "")


def _options(error: cyclopts.CycloptsError) -> list[str]:
    """Return the options of the command of an error."""
    taken = error.app.assemble_argument_collection() if error.app else ()
    return [argument.name for argument in taken if not argument.field_info.is_positional]


def _issue_of(error: Exception) -> Issue:
    """Return the message for an error that no command foresaw."""
    cause: BaseException | None = error
    while cause is not None:
        if getattr(cause, "errno", None) in _FULL or os.strerror(errno.ENOSPC) in str(cause):
            return _full(getattr(cause, "filename", None))
        cause = cause.__cause__ or cause.__context__
    if isinstance(error, MemoryError):
        return _out_of_memory()
    return _of_file(error) if isinstance(error, OSError) else _unforeseen(error)


def _full(file: str | None) -> Issue:
    return Issue(
        "the disk is full",
        str(file or "the folder of the output, the temporary folder, or standard output"),
        "a disk with enough free space",
        "make room, or choose another place with --out or TMPDIR; an earlier result is unchanged",
    )


def _out_of_memory() -> Issue:
    return Issue(
        "there is not enough memory", "this command", "memory for all runs that are fitted jointly",
        "fit fewer runs or rows at once, or use a machine with more memory",
    )  # fmt: skip


def _of_file(error: OSError) -> Issue:
    return Issue(
        f"file system error: {error.strerror or error}",
        str(error.filename2 or error.filename or "a file or stream of this command"),
        "an existing file to read, or a writable folder",
        "choose another path, or correct its permissions",
    )


def _unforeseen(error: Exception) -> Issue:
    return Issue(
        f"internal error: {type(error).__name__}: {error}",
        "inside imubayes",
        "",
        "set IMUBAYES_TRACEBACK=1, run the command again and report its output",
    )


if __name__ == "__main__":
    main()
