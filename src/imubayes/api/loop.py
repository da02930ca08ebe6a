"""The loop as functions: find what a model lacks, add or remove effects, inject effects, and see the tree of models."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace as with_fields
from pathlib import Path

from imubayes.api.fitting import bound, keep_beside
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.display.progress import progress_of
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import input_error, kept_if_possible
from imubayes.foundations.files import refuse_existing
from imubayes.foundations.records import several
from imubayes.inference.chains import Settings
from imubayes.inference.checkpoint import steps_in
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.loop.cross_validation import objection
from imubayes.loop.injection_recovery import Size, Trials, plant_effects
from imubayes.loop.model_changes import refit_edited, refit_with, refit_without
from imubayes.loop.model_history import Tree
from imubayes.loop.refit import Refit
from imubayes.model.bind import bind
from imubayes.model.effect_registry import names_in
from imubayes.model.model_file import ModelSpec, read_model
from imubayes.results import change_records as changes
from imubayes.results.change_records import ModelChange
from imubayes.results.folder_files import CHECKPOINT
from imubayes.results.folder_state import claimed_new
from imubayes.results.history_tree import campaign_of, next_selection, read_tree
from imubayes.results.result import Result, opened, result_of
from imubayes.results.result_folder import write_result


def diagnose(
    result: Result | Fit | str | Path, effect: str = "", *, progress: Callable[[str], None] | None = None
) -> Diagnosis:
    """Return which physical effect is missing in a fit, or that none is, from one pass and without a refit.

    The diagnosis is kept in the result folder, if there is one; `add` starts from it. If the folder cannot be written
    to, the warning `NotKept` is issued.

    Parameters
    ----------
    result : a result, its folder, or a fitted model.
    effect : ask about this effect alone; such an answer is not kept.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a folder that holds no result, or one whose campaign is gone or has changed.

    Examples
    --------
    >>> import imubayes
    >>> found = imubayes.diagnose("results/accel-channel")
    >>> found.verdict
    'adequate'
    """
    with progress_of(progress) as tell:
        tell("reading the fit")
        if isinstance(result, Fit):
            return judge(result, effect=effect, progress=tell)
        read = opened(result)
        found = judge(read.fit, str(read.folder or "RESULT"), effect, tell)
    if read.folder is not None and not effect:
        with kept_if_possible(read.folder):
            changes.write_diagnosis(read.folder, found, read.identity)
    return found


def plant(
    campaign: Campaign | str | Path | None = None,
    model: ModelSpec | str | Path | None = None,
    *,
    result: Result | str | Path | None = None,
    effects: str | Sequence[str] | None = None,
    size: Size | None = None,
    draws: int = 20,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Trials:
    """Inject each effect that the model lacks into data simulated from the fit, and report which are found.

    Parameters
    ----------
    campaign, model : campaign and model to fit first; not needed with a result.
    result : a fit to take instead.
    effects : which to inject; all of the catalogue that the model lacks if None.
    size : how large they are; by default the size with Δχ² = 50.
    draws : simulations without any effect, for the false-alarm rate.
    seed : of the simulations.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for anything that cannot be used, and for free tumbles, which cannot be simulated.

    Examples
    --------
    >>> import imubayes
    >>> trials = imubayes.plant(result="results/accel-channel", effects=["converter_offset_drift_quadratic"], draws=1)
    >>> [trial.effect for trial in trials.trials]
    ['converter_offset_drift_quadratic']
    """
    with progress_of(progress) as tell:
        if result is not None:
            fitted = opened(result).fit
        elif campaign is None or model is None:
            raise input_error(
                "nothing to inject into", "plant", "a campaign with a model, or a result", "give one of the two"
            )
        else:
            tell("fitting")
            fitted = joint_fit(bound(campaign, model), None, progress=tell)
        return plant_effects(fitted, None if effects is None else several(effects), size or Size(), draws, seed, tell)


def add(
    result: Result | str | Path,
    effects: str | Sequence[str] = (),
    out: str | Path | None = None,
    channels: str | Sequence[str] | None = None,
    *,
    diagnosis: Diagnosis | None = None,
    sample: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> ModelChange:
    """Add effects to the model of a result, refit from its mode, and report the improvement.

    A refit is taken only if it converged and is no worse; no result is overwritten.

    Parameters
    ----------
    result : a result, or its folder.
    effects : names of effects or noise members, or Python files that define effects (``found_shape.py``); the simplest
        explanation of the diagnosis if there are none.
    out : result folder to write; None for none.  It becomes the selected model if the refit is taken.
    channels : for the new effects; if None, those on which the diagnosis found them, or else all they can act on.
    diagnosis : of the result; its estimates are where the refit starts.  If None, the one that the result folder
        holds, if any.
    sample : whether to sample the posterior of a refit that is taken.
    seed : of the sampler.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for an effect that does not fit, a result that cannot be extended, an `out` that is taken.

    Examples
    --------
    >>> import imubayes
    >>> lacking = imubayes.remove("results/accel-channel", ["converter_offset_drift"]).result
    >>> change = imubayes.add(lacking, ["converter_offset_drift"])
    >>> change.taken
    True
    """
    before = opened(result)
    if diagnosis is None and before.folder is not None:
        diagnosis = changes.read_diagnosis(before.folder)
    words = several(effects)
    files = tuple(word for word in words if word.endswith(".py"))
    named, acting_on = _named(_words(words), None if channels is None else several(channels), diagnosis)

    def refit(tell: Callable[[str], None]) -> Refit:
        return refit_with(before.fit, named, acting_on, diagnosis, tell, files)

    return _changed(before, refit, out, diagnosis, Settings(seed=seed) if sample else None, seed, progress)


def remove(
    result: Result | str | Path,
    effects: str | Sequence[str],
    out: str | Path | None = None,
    *,
    sample: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> ModelChange:
    """Remove effects from the model of a result, refit from its mode, and report the loss.

    Parameters that stay start where they were.  A refit is taken only if it converged; no result is overwritten.

    Parameters
    ----------
    result : a result, or its folder.
    effects : names of effects or noise members of its model, or Python files that define some of them.
    out : result folder to write; None for none.  It becomes the selected model if the refit is taken.
    sample : whether to sample the posterior of a refit that is taken.
    seed : of the sampler.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for an effect that the model does not have or that others of it require, and for an `out` that is taken.

    Examples
    --------
    >>> import imubayes
    >>> change = imubayes.remove("results/accel-channel", ["converter_offset_drift"])
    >>> change.observed.delta_chi2 < -20  # what it costs
    True
    """
    before = opened(result)
    words, parent = _words(several(effects)), before.folder
    if not words:
        raise input_error("no effect is named", "remove", "effects of the model", "name one")
    stay = [each.name for each in before.fit.model.spec.effects if each.name not in words]
    log_odds = changes.log_odds_of_removal(parent, words, stay) if parent is not None else None
    diagnosis = changes.read_diagnosis(parent) if parent is not None else None

    def refit(tell: Callable[[str], None]) -> Refit:
        return refit_without(before.fit, words, tell)

    sampling = Settings(seed=seed) if sample else None
    return _changed(before, refit, out, diagnosis, sampling, seed, progress, log_odds)


def refit(
    result: Result | str | Path,
    model: ModelSpec | str | Path,
    out: str | Path | None = None,
    *,
    sample: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> ModelChange:
    """Fit the campaign of a result again with its model edited, from its mode: other priors, readings set aside.

    The refit is a branch of the tree of models; no result is overwritten.

    Parameters
    ----------
    result : a result, or its folder.
    model : the edited model, or its file.
    out : result folder to write; None for none.  It becomes the selected model if the refit is taken.
    sample : whether to sample the posterior of a refit that is taken.
    seed : of the sampler.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a model that does not fit the campaign, a result that cannot be continued, an `out` that is taken.

    Examples
    --------
    >>> import imubayes
    >>> change = imubayes.refit("results/accel-channel", "accel-channel")  # nothing was edited
    >>> abs(change.observed.delta_chi2) < 0.01
    True
    """
    before = opened(result)
    old = before.fit.model
    spec = model if isinstance(model, ModelSpec) else read_model(model)
    whole = campaign_of(before.folder) if old.campaign.set_aside and before.folder is not None else old.campaign
    edited = bind(spec, whole if whole is not None else old.campaign)
    diagnosis = changes.read_diagnosis(before.folder) if before.folder is not None else None

    def make(tell: Callable[[str], None]) -> Refit:
        return refit_edited(before.fit, edited, tell)

    return _changed(before, make, out, diagnosis, Settings(seed=seed) if sample else None, seed, progress)


def _changed(
    before: Result,
    make: Callable[[Callable[[str], None]], Refit],
    out: str | Path | None,
    diagnosis: Diagnosis | None,
    sampling: Settings | None,
    seed: int,
    progress: Callable[[str], None] | None,
    log_odds: float | None = None,
) -> ModelChange:
    """Return a change of a model, kept in a result folder and in the history if there is one.

    Parameters
    ----------
    make : makes the refit; it is called with a function that reports the progress.
    sampling : of a refit that is taken; None for the Laplace approximation.
    log_odds : of effects removed.
    """
    parent = before.folder
    folder = Path(out) if out is not None else None
    with claimed_new(folder, parent), progress_of(progress) as tell:
        refit = make(tell)
        if sampling is not None and not refit.objection:
            refit = _sampled(refit, folder, sampling, tell)
        tell("summarising")
        change = changes.change_of(refit, before, result_of(refit.fit, folder, seed), log_odds)
        if folder is None:
            return change
        written = write_result(
            change.result,
            changes.next_node(parent, change, diagnosis, seed),
            change=change,
            added_variable=changes.added_variable(refit.change) if change.added else None,
            selection=next_selection(parent) if parent is not None and change.taken else 0,
        )
        if refit.fit.posterior is not None and refit.fit.posterior.chains is not None and not refit.objection:
            keep_beside(written, tell)
    return change.with_result(written)


def _words(effects: Sequence[str]) -> list[str]:
    """Return the names of effects; a Python file stands for those that it defines."""
    return [name for word in effects for name in (names_in(word) if word.endswith(".py") else (word,))]


def _named(
    effects: Sequence[str], channels: Sequence[str] | None, diagnosis: Diagnosis | None
) -> tuple[Sequence[str], Sequence[str] | None]:
    """Return effects and channels to add: as named, or the simplest explanation of the diagnosis.

    Several effects share one list of channels, so that of the diagnosis is taken for a single effect.
    """
    if effects:
        found = diagnosis.channels_for(effects[0]) if diagnosis is not None and len(effects) == 1 else None
        return effects, channels if channels is not None else found
    proposed = diagnosis.proposed if diagnosis is not None else None
    if proposed is None:
        allowed = "an effect that a diagnosis of the result proposes, or that `imubayes effects` lists"
        if diagnosis is not None:
            raise input_error("no effect is named, and the diagnosis proposes none", "add", allowed, "name one")
        fault, remedy = "the result was not diagnosed", "run `imubayes diagnose RESULT`, or name an effect"
        raise input_error(f"no effect is named, and {fault}", "add", allowed, remedy)
    return proposed.effects, channels or proposed.channels


def _sampled(refit: Refit, folder: Path | None, sampling: Settings, tell: Callable[[str], None]) -> Refit:
    """Return the refit with its posterior sampled; if an earlier call was interrupted, its sampling is resumed."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / CHECKPOINT if folder is not None else None
    resume = checkpoint is not None and bool(steps_in(checkpoint))
    start = (refit.fit.z, refit.fit.h)
    fit = joint_fit(refit.fit.model, sampling, checkpoint, resume, tell, start)
    return with_fields(refit, fit=fit, objection=objection(fit, refit.delta_chi2, bool(refit.change.removed)))


def history(*folders: str | Path) -> Tree:
    """Return the tree of models tried to which result folders belong.

    Parameters
    ----------
    folders : result folders; the models before and after each are found from it.

    Raises
    ------
    InputError
        for a folder that holds no result.

    Examples
    --------
    >>> import imubayes
    >>> tree = imubayes.history("results/accel-channel")
    >>> len(tree.selected)
    1
    """
    return read_tree(folders)


def export(folder: str | Path, file: str | Path) -> str:
    """Write the selected model of the tree that a result belongs to, as a model file; return its path.

    The user's own effect files go beside it.

    Parameters
    ----------
    folder : result folder of any model of the tree.
    file : model file to write.

    Raises
    ------
    InputError
        for a folder that holds no result, and if another effect file is in the way.

    Examples
    --------
    >>> import imubayes
    >>> chosen = imubayes.export("results/accel-channel", "next/model.toml")
    >>> imubayes.load_model("next/model.toml").name
    'accel-channel'
    """
    tree, place = read_tree([folder]), str(Path(folder).resolve())
    together = tree.together_with(place)
    chosen = next(other for other in (*tree.selected, place) if other in together)
    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    own = {Path(source): file.parent / Path(source).name for source in read_model(Path(chosen) / "model.toml").files}
    for source, target in own.items():
        refuse_existing(target, but=source.read_bytes().__eq__)
    for source, target in own.items():
        shutil.copyfile(source, target)
    shutil.copyfile(Path(chosen) / "model.toml", file)
    return chosen
