"""Commands `imubayes demo` and `imubayes example`: the campaigns, models and test plans that come with the package."""

import shlex
from pathlib import Path

from imubayes.cli.fit import compare, fit
from imubayes.cli.loop import diagnose
from imubayes.cli.session import Flag
from imubayes.foundations.errors import input_error
from imubayes.foundations.extensions import extensions
from imubayes.foundations.shipped_examples import copy_examples, examples
from imubayes.foundations.shipped_examples import example as named

_FOLDER = Path("imubayes-demo")
_SHOWN, _COMPLETE = "hidden-gyro", "trihedral-imu"  # where an effect is missing, and where none is


def demo(
    name: str = _SHOWN, *, out: Path = _FOLDER, sample: bool = True, replace: Flag = False
) -> int:  # fmt: skip
    """Copy an example to a folder, fit it, diagnose it, and compare it with its measurements.

    The default example lacks an effect, which the diagnosis names; the comparison begins
    with the quantity on which the effect depends.

    Example: imubayes demo --out imubayes-demo

    Parameters
    ----------
    name
        A campaign listed by `imubayes example`.
    out
        Folder to write: the example, and the result in its subfolder results.
    sample
        Sample the posterior; with --no-sample the Laplace approximation is used.
    replace
        Replace a sampled result of an earlier demonstration.
    """
    chosen = named(name)
    if not chosen.is_campaign:
        campaigns = ", ".join(each.name for each in examples().values() if each.is_campaign)
        raise input_error(f"'{name}' is an archive of units", "argument NAME", campaigns, "name a single campaign")
    copy_examples([chosen], out)
    campaign, model, result = out / chosen.data, out / chosen.model, out / "results" / name
    _announce("fit", campaign, "--model", model, "--out", result, *([] if sample else ["--no-sample"]))
    if status := fit(campaign, model=model, out=result, sample=sample, replace=replace):
        return status
    # The comparison draws residuals against the covariate that the diagnosis names.
    _announce("diagnose", result)
    status = diagnose(result)
    _announce("compare", result)
    compare(result)
    other = _COMPLETE if name == _SHOWN else _SHOWN
    print(f"\nopen this page: {(result / 'compare.html').resolve()}\nnext:")
    for package, line in (
        (
            "explorer",
            f"{_command('explore', result)}    the loop in the browser (extra: pip install 'imubayes[explore]')",
        ),
        ("qualification", f"{_command('report', result, '--out', out / 'report.html')}    the uncertainty report"),
        ("", f"imubayes demo {other}    {examples()[other].summary}"),
        ("recordings", "imubayes new FOLDER RECORDING    a recording of your own"),
    ):
        if not package or package in extensions("commands"):
            print(f"  {line}")
    return status


def example(*names: str, out: Path | None = None) -> None:
    """Copy shipped examples: campaigns with their models and test plans. Without a name, list them.

    The copies are in FOLDER/data and FOLDER/models, so that the commands of the documentation run in FOLDER. A shipped
    model can also be named without a copy: `--model trihedral-imu`.

    Example: imubayes example hidden-gyro --out tour

    Parameters
    ----------
    names
        Campaigns or archives to copy.
    out
        Folder to write.
    """
    if not names:
        _list()
        return
    if out is None:
        raise input_error("no folder is given", "command line", "--out FOLDER", "add it; --out . is this folder")
    chosen = [named(name) for name in names]
    for place in copy_examples(chosen, out):
        print(f"written: {place}")
    first = chosen[0]
    verb = f"check {first.data} --model" if first.is_campaign else f"batch {first.data} --out results/units --model"
    print(f"next, in {out}: imubayes {verb} {first.model}")


def _list() -> None:
    from imubayes.display.layout import Report, Sheet, cells, print_report

    rows = [cells(each.name, each.model.stem, each.summary) for each in examples().values()]
    closing = ["imubayes example NAME --out FOLDER copies one. Its model can also be named without a copy."]
    print_report(Report((), [Sheet("", ["example", "model", "what it is"], rows, left=(0, 1, 2))], closing))


def _announce(*words: str | Path) -> None:
    print(f"\n$ {_command(*words)}", flush=True)


def _command(*words: str | Path) -> str:
    return shlex.join(["imubayes", *map(str, words)])
