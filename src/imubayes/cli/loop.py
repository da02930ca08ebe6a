"""Commands of the model loop: `imubayes diagnose`, `add`, `remove`, `refit`, `plant` and `history`.

`diagnose` names the effects that a model lacks.  `add` is a step forward, with its improvement; `remove` is a step
back, with its loss; `refit` takes an edited model.  `plant` shows whether an effect would have been found.  `history`
shows the models tried.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import cyclopts

from imubayes.cli.session import Flag, Json, Names, Trust, progress, show, split, start_jax, trusting
from imubayes.foundations.errors import input_error

if TYPE_CHECKING:
    from imubayes.criticism.diagnosis_record import Diagnosis
    from imubayes.loop.model_history import Tree
    from imubayes.results.change_records import ModelChange


@cyclopts.Parameter(name="*")
@dataclass(frozen=True)
class _HowRefitted:
    """How a changed model is fitted and shown: the options that `add`, `remove` and `refit` have in common.

    Parameters
    ----------
    sample
        Sample the posterior; by default the Laplace approximation is used.
    seed
        Seed of the sampler.
    as_json
        Print one JSON object on standard output.
    verbose
        List the residual rms of every channel and run, also of those that did not change.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """

    sample: Annotated[bool, cyclopts.Parameter(negative="--no-sample")] = False
    seed: int = 0
    as_json: Json = False
    verbose: Flag = False
    trust: Trust = False


_LAPLACE = _HowRefitted()


def add(
    *effects: str,
    to: Path,
    out: Path,
    channels: Names = None,
    how: _HowRefitted = _LAPLACE,
) -> int:
    """Add effects to the model of a result, fit again from there, and show the improvement.

    Example: imubayes add gyro_g_sensitivity --to results/first --out results/second

    Parameters
    ----------
    effects
        Names of effects or noise components; `imubayes effects` lists them. A Python file
        adds the effects that it defines; `imubayes diagnose --python` prints such a file. Without names, the
        simplest explanation of the diagnosis is added.
    to
        Result folder of the model to start from; it is not changed.
    out
        Result folder to write.
    channels
        Channels that the effects act on; by default those the diagnosis named, or all they can act on.
    """
    with progress() as tell:
        start_jax("add")
        trusting(to, how.trust)
        from imubayes.api import add as add_effects

        change = add_effects(to, effects, out, split(channels), sample=how.sample, seed=how.seed, progress=tell)
    return print_change(change, how.as_json, how.verbose)


def print_change(change: "ModelChange", as_json: bool, verbose: bool) -> int:
    """Print what a change of a model brought; return the exit status: 0 if the refit is taken, else 1."""
    from imubayes.display.loop.change_report import change_report, next_command

    record = change.model_dump(mode="json") | {"next": next_command(change)}
    show(lambda: record, lambda: change_report(change, verbose), as_json)
    if not change.taken:
        print(change.message, file=sys.stderr)
    return 0 if change.taken else 1


def diagnose(
    result: Path,
    *,
    effect: str = "",
    as_json: Json = False,
    python: Flag = False,
    verbose: Flag = False,
    trust: Trust = False,
) -> int:
    """Name the effects that the model lacks, in one pass and without a refit.

    Example: imubayes diagnose results/first

    Parameters
    ----------
    result
        Result folder of a fit.
    effect
        Ask about this effect alone: present, absent, or undetectable in these runs.
    as_json
        Print one JSON object on standard output.
    python
        Print an effect class for the pattern that no effect of the catalogue explains: save it in a file, and add that
        with `imubayes add FILE.py`.
    verbose
        Print every table: all effects, noise, outliers, formulas and undetectable effects.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with progress() as tell:
        start_jax("diagnose")
        trusting(result, trust)
        from imubayes.api import diagnose as find_missing
        from imubayes.api import load
        from imubayes.display.loop.diagnosis_report import diagnosis_json, diagnosis_report, effect_source

        read = load(result)
        found = find_missing(read, effect, progress=tell)
        tell("drawing")
        pictures = (
            [] if effect else _pictures(result, read.identity, found)
        )  # an answer about one effect leaves the others' alone
    if python:
        print(effect_source(found))
    else:
        show(lambda: diagnosis_json(found), lambda: diagnosis_report(found, pictures, verbose), as_json)
    return 1 if found.verdict == "not_converged" else 0


def _pictures(result: Path, identity: str, found: "Diagnosis") -> list[Path]:
    """Draw what the diagnosis rests on; Matplotlib is imported if there is something to draw."""
    from imubayes.foundations.errors import kept_if_possible
    from imubayes.results.folder_files import DIAGNOSIS_PICTURE, FIGURES, NOISE_PICTURE, same_fit

    pictures = []
    with kept_if_possible(result):
        same_fit(result, identity)
        for name in (DIAGNOSIS_PICTURE, NOISE_PICTURE):  # of an earlier diagnosis
            (result / FIGURES / name).unlink(missing_ok=True)
        if found.evidence is not None:
            from imubayes.display.figures.residual_evidence import save_evidence

            pictures.append(save_evidence(result, found.evidence))
        if found.disagreeing_noise and found.scatter is not None:
            from imubayes.display.figures.residual_evidence import save_recorded_noise

            pictures.append(save_recorded_noise(result, found.scatter))
    return pictures


def history(
    *results: Path,
    select: Path | None = None,
    export: Path | None = None,
    html: Path | None = None,
    as_json: Json = False,
) -> None:
    """Show the models tried, how the error fell, and which one is selected.

    Example: imubayes history results/second --html history.html

    Parameters
    ----------
    results
        Result folders. The models before and after each of them are found automatically.
    select
        Make this result the selected one; to undo a step, select the result before it.
    export
        Write the selected model to this model file.
    html
        Write the models tried, with their evidence, as one HTML page.
    as_json
        Print one JSON object on standard output.
    """
    folders = [*results, *([select] if select is not None and not results else [])]
    if not folders:
        raise input_error("no result is named", "command line", "result folders", "name at least one")
    with progress() as tell:
        # What reads alone needs no JAX, which takes seconds to import.
        from imubayes.display.loop.history import history_json, history_report
        from imubayes.foundations.files import refuse_existing
        from imubayes.results.history_tree import read_tree
        from imubayes.results.history_tree import select as select_node

        if export is not None:
            refuse_existing(export)
        if html is not None:
            refuse_existing(html, but=lambda content: content.startswith(b"<!doctype html>"))
        if select is not None:
            select_node(select)
        tree = read_tree(folders)
        if export is not None:
            start_jax()
            from imubayes.api import export as export_model

            export_model(folders[0], export)
        if html is not None:
            tell("drawing")
            _write_page(html, tree)
    show(lambda: history_json(tree), lambda: history_report(tree), as_json)
    for file in (export, html) if not as_json else ():
        if file is not None:
            print(f"written: {file}")


def _write_page(html: Path, tree: "Tree") -> None:
    start_jax()
    from imubayes.display.loop.history_page import history_page
    from imubayes.foundations.files import write_text
    from imubayes.results.change_records import read_steps

    write_text(html, history_page(tree, {place: tuple(read_steps(tree, place)) for place in tree.selected}))


def plant(
    campaign: Path | None = None,
    *,
    model: Path | None = None,
    result: Path | None = None,
    effects: Names = None,
    size: float | None = None,
    delta_chi2: Annotated[float, cyclopts.Parameter(name="--delta-chi2")] = 50.0,
    draws: int = 20,
    seed: int = 0,
    as_json: Json = False,
    trust: Trust = False,
) -> None:
    """Plant effects into data simulated from the fit, and see which the diagnosis would have found.

    Example: imubayes plant data/trihedral-imu --model models/trihedral-imu.toml --effects gyro_g2_sensitivity

    Parameters
    ----------
    campaign
        Folder with campaign.toml; not needed with --result.
    model
        Model file, or the name of a shipped model; fitted first.
    result
        Result folder to use in place of a new fit.
    effects
        Effects to plant; by default all that the model lacks.
    size
        Plant each effect at this multiple of the largest size met in practice.
    delta_chi2
        Plant each effect at the size at which adding it would lower chi2 by this much.
    draws
        Simulations with nothing planted, for the rate of false alarms.
    seed
        Seed of the simulations.
    as_json
        Print one JSON object on standard output.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with progress() as tell:
        start_jax()
        trusting(result, trust)
        from imubayes.api import plant as plant_effects
        from imubayes.display.loop.change_report import injection_json, injection_report
        from imubayes.loop.injection_recovery import Size

        trials = plant_effects(
            campaign, model, result=result, effects=split(effects),
            size=Size(delta_chi2, size), draws=draws, seed=seed, progress=tell,
        )  # fmt: skip
    show(lambda: injection_json(trials), lambda: injection_report(trials), as_json)


def remove(
    *effects: str,
    source: Annotated[Path, cyclopts.Parameter(name="--from")],
    out: Path,
    how: _HowRefitted = _LAPLACE,
) -> int:
    """Remove effects from the model of a result, fit again from there, and show the loss.

    Example: imubayes remove gyro_g_sensitivity --from results/second --out results/without

    Parameters
    ----------
    effects
        Names of effects or noise components of the model, or a Python file that defines some of them.
    source
        Result folder of the model to start from; it is not changed.
    out
        Result folder to write.
    """
    if not effects:
        raise input_error("no effect is named", "command line", "effects of the model", "name one")
    with progress() as tell:
        start_jax("remove")
        trusting(source, how.trust)
        from imubayes.api import remove as remove_effects

        change = remove_effects(source, effects, out, sample=how.sample, seed=how.seed, progress=tell)
    return print_change(change, how.as_json, how.verbose)


def refit(
    result: Path,
    *,
    model: Path,
    out: Path,
    how: _HowRefitted = _LAPLACE,
) -> int:
    """Fit again after an edit of the model file of a result: other priors, readings set aside with a reason.

    Example: imubayes refit results/first --model edited.toml --out results/third

    Parameters
    ----------
    result
        Result folder of the model to start from; it is not changed.
    model
        Its model file, edited: RESULT/model.toml is a copy to begin with.
    out
        Result folder to write.
    """
    with progress() as tell:
        start_jax("add")  # whose programs it uses
        trusting(result, how.trust)
        from imubayes.api import refit as refit_edited

        change = refit_edited(result, model, out, sample=how.sample, seed=how.seed, progress=tell)
    return print_change(change, how.as_json, how.verbose)
