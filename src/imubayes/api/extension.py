"""Add an effect to a model, and the tree of models tried."""

import shutil
from collections.abc import Callable, Sequence
from dataclasses import replace as with_fields
from pathlib import Path

from imubayes.atomic_files import refuse_existing
from imubayes.criticism.addition import Refit, refit_with
from imubayes.criticism.cross_validation import objection
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.model_history import Tree
from imubayes.display.notebook_progress import progress_of
from imubayes.errors import input_error
from imubayes.inference.checkpoint import steps_in
from imubayes.inference.ensemble_sampling import Settings
from imubayes.inference.run_fit import joint_fit
from imubayes.model.effect_registry import names_in
from imubayes.model.model_file import read_model
from imubayes.qualification.report_budgets import keep_budgets
from imubayes.results.addition import Addition, added_variable, addition_of
from imubayes.results.folder_state import claim_new
from imubayes.results.history_file import remember
from imubayes.results.history_tree import read_tree
from imubayes.results.loop_files import read_diagnosis, write_addition
from imubayes.results.record_names import CHECKPOINT
from imubayes.results.result import Result, read_result, result_of


def add(
    result: Result | str | Path,
    effects: Sequence[str] = (),
    out: str | Path | None = None,
    channels: Sequence[str] | None = None,
    *,
    diagnosis: Diagnosis | None = None,
    sample: bool = False,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Addition:
    """Add effects to the model of a result, refit from where it stood, and report what that brought.

    A refit is taken only where it converged and is no worse; no result is overwritten.

    Parameters
    ----------
    result : a result, or its folder.
    effects : names of effects or noise members, or Python files that define effects (``found_shape.py``); what the
        diagnosis proposes where there are none.
    out : result folder to write; None for none.  It becomes the selected model where the refit is taken.
    channels : for the new effects; where None, those on which the diagnosis found them, or else all they can act on.
    diagnosis : of the result; its estimates are where the refit starts.  Where None, the one that the result folder
        holds, if any.
    sample : whether to sample the posterior of a refit that is taken.
    seed : of the sampler.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for an effect that does not fit, a result that cannot be extended, an `out` that is taken.
    """
    before = result if isinstance(result, Result) else read_result(result)
    parent = before.folder
    if diagnosis is None and parent is not None:
        diagnosis = read_diagnosis(parent)
    files = tuple(word for word in effects if word.endswith(".py"))
    _refuse_two_files_of_a_name((*before.fit.model.spec.files, *files))
    words = [name for word in effects for name in (names_in(word) if word in files else (word,))]
    effects, channels = _named(words, channels, diagnosis)
    folder = claim_new(Path(out), parent) if out is not None else None
    with progress_of(progress) as tell:
        refit = refit_with(before.fit, effects, channels, diagnosis, tell, files)
        if sample and not refit.objection:
            refit = _sampled(refit, folder, seed, tell)
        tell("summarising")
        after = result_of(refit.fit, folder, seed)
    addition = addition_of(refit, before, after)
    if folder is not None:
        write_addition(folder, addition, added_variable(refit.extension))
        if parent is not None:
            remember(parent, folder, addition, diagnosis, seed)
        _keep_budgets_of(after, refit)
    return addition


def _keep_budgets_of(after: Result, refit: Refit) -> None:
    """Keep the budgets of a refit that was sampled and taken: the quick ones of the loop leave them to a report."""
    posterior = refit.fit.posterior
    if posterior is not None and posterior.chains is not None and not refit.objection:
        keep_budgets(after)


def _refuse_two_files_of_a_name(files: Sequence[str]) -> None:
    """Raise where a result folder, which has the files side by side, could not hold them."""
    known: dict[str, Path] = {}
    for file in map(Path, files):
        other = known.setdefault(file.name, file)
        if other.resolve() != file.resolve() and other.is_file():
            raise input_error(
                f"the model has another file '{file.name}' already",
                str(file),
                "files with names of their own",
                "rename the new file, and the effect in it",
            )


def _named(
    effects: Sequence[str], channels: Sequence[str] | None, diagnosis: Diagnosis | None
) -> tuple[Sequence[str], Sequence[str] | None]:
    """Return effects and channels to add: as named, or as the diagnosis proposes.

    Several effects share one list of channels, so that of the diagnosis is taken for a single effect.
    """
    if effects:
        found = diagnosis.channels_for(effects[0]) if diagnosis is not None and len(effects) == 1 else None
        return effects, channels if channels is not None else found
    proposed = diagnosis.proposed if diagnosis is not None else None
    if proposed is None:
        raise input_error("no effect is named", "add", "imubayes effects lists them", "name one")
    return proposed.effects, channels or proposed.channels


def _sampled(refit: Refit, folder: Path | None, seed: int, tell: Callable[[str], None]) -> Refit:
    """Return the refit with its posterior sampled; where an earlier call was interrupted, its sampling is resumed."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / CHECKPOINT if folder is not None else None
    resume = checkpoint is not None and bool(steps_in(checkpoint))
    start = (refit.fit.z, refit.fit.h)
    fit = joint_fit(refit.fit.model, Settings(seed=seed), checkpoint, resume, tell, start)
    return with_fields(refit, fit=fit, objection=objection(fit, refit.delta_chi2))


def history(*folders: str | Path) -> Tree:
    """Return the tree of models tried that result folders stand in."""
    return read_tree(folders)


def export(folder: str | Path, file: str | Path) -> str:
    """Write the selected model of the tree that a result stands in to a model file; return its place.

    The user's own effect files go beside it.
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
