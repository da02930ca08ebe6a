"""The Python interface: the same words as on the command line."""

import shutil
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace as with_fields
from pathlib import Path

import polars as pl

from imubayes.atomic_files import refuse_existing
from imubayes.campaign import load_campaign
from imubayes.campaign_data import Campaign
from imubayes.criticism.addition import Refit, refit_with
from imubayes.criticism.cross_validation import objection
from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.injection_recovery import Size, Trials, plant_effects
from imubayes.criticism.model_history import Tree
from imubayes.display.notebook_progress import progress_of
from imubayes.display.onboard.export_files import ExportOptions, Format, write_constants
from imubayes.errors import input_error
from imubayes.inference.checkpoint import steps_in
from imubayes.inference.ensemble_sampling import Settings
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model, bind
from imubayes.model.effect_registry import names_in
from imubayes.model.model_file import read_model
from imubayes.model.model_spec import ModelSpec
from imubayes.qualification.build_report import report_of
from imubayes.qualification.digits import Digits
from imubayes.qualification.noise_densities import of_fit, of_record, read_noise
from imubayes.qualification.onboard_constants import onboard_constants as constants_of
from imubayes.qualification.onboard_losses import Loss
from imubayes.qualification.onboard_record import OnboardConstants
from imubayes.qualification.recording_files import CorrectedRecording, correct_recording, open_recording
from imubayes.qualification.report_budgets import keep_budgets
from imubayes.qualification.report_record import QualificationReport
from imubayes.qualification.until_digits import fit_until_digits
from imubayes.representation import displayed_by
from imubayes.results.addition import Addition, added_variable, addition_of
from imubayes.results.apply_calibration import CalibratedInputs, apply_calibration, read_readings
from imubayes.results.folder_state import claim, claim_new
from imubayes.results.history_file import first_node, remember
from imubayes.results.history_tree import read_tree, write_node
from imubayes.results.loop_files import read_diagnosis, write_addition, write_diagnosis
from imubayes.results.record_names import CHECKPOINT
from imubayes.results.result import Result, read_result, result_of

displayed_by("imubayes.display.registered_representations")


def fit(
    campaign: Campaign | str | Path,
    model: ModelSpec | str | Path,
    out: str | Path | None = None,
    *,
    sample: bool = True,
    seed: int = 0,
    resume: bool = False,
    replace: bool = False,
    settings: Settings | None = None,
    until_digits: Digits | None = None,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Fit all runs of a campaign jointly and sample the posterior.

    Parameters
    ----------
    campaign : a campaign, or its folder.
    model : a model, or its file.
    out : result folder to write; None for none.
    sample : whether to sample, or to stay with the Laplace approximation.
    seed : of the sampler.
    resume : continue the checkpoint in `out`.
    replace : whether a sampled result in `out` may be replaced; one that was not sampled always is.
    settings : of the sampler, beyond the seed.
    until_digits : significant digits of the standard uncertainty that every quantity is to deserve (JCGM 101, 7.9.4);
        sampling goes on until then, or until memory allows no more.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for anything that cannot be used; nothing is written then.
    """
    clock = time.perf_counter()
    declared = _bound(campaign, model)
    load_seconds = time.perf_counter() - clock
    folder = Path(out) if out is not None else None
    checkpoint = folder / CHECKPOINT if folder is not None else None
    if folder is not None:
        claim(folder, resume, replace)
    sampling = with_fields(settings or Settings(), seed=seed) if sample else None
    with progress_of(progress) as tell:
        if until_digits is not None:
            fitted = fit_until_digits(declared, sampling, until_digits, checkpoint, resume, tell)
        else:
            fitted = joint_fit(declared, sampling, checkpoint, resume, tell)
        tell("summarising")
        result = result_of(fitted, folder, seed, load_seconds)
        if folder is not None:
            write_node(folder, first_node(fitted.model, result.summary, seed))
            if sample:  # a quick fit of the loop leaves them to its first report
                tell("uncertainty budgets")
                keep_budgets(result)
    return result


def _bound(campaign: Campaign | str | Path, model: ModelSpec | str | Path) -> Model:
    loaded = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
    return bind(model if isinstance(model, ModelSpec) else read_model(model), loaded)


def diagnose(
    result: Result | Fit | str | Path, effect: str = "", *, progress: Callable[[str], None] | None = None
) -> Diagnosis:
    """Return which physical effect is missing in a fit, or that none is, from one pass and without a refit.

    What was found is kept in the result folder, where there is one: `add` starts from it.

    Parameters
    ----------
    result : a result, its folder, or a fitted model.
    effect : ask about this effect alone; such an answer is not kept.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a folder that holds no result, or one whose campaign is gone or has changed.
    """
    with progress_of(progress) as tell:
        tell("reading the fit")
        if isinstance(result, Fit):
            return judge(result, effect=effect, progress=tell)
        read = result if isinstance(result, Result) else read_result(result)
        found = judge(read.fit, str(read.folder or "RESULT"), effect, tell)
    if read.folder is not None and not effect:
        write_diagnosis(read.folder, found)
    return found


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
        diagnosis suggests where there are none.
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
    """Return effects and channels to add: as named, or as the diagnosis suggests.

    Several effects share one list of channels, so that of the diagnosis is taken for a single effect.
    """
    if effects:
        found = diagnosis.channels_for(effects[0]) if diagnosis is not None and len(effects) == 1 else None
        return effects, channels if channels is not None else found
    suggested = diagnosis.suggested if diagnosis is not None else None
    if suggested is None:
        raise input_error("no effect is named", "add", "imubayes effects lists them", "name one")
    return [suggested.effect], channels or suggested.channels


def _sampled(refit: Refit, folder: Path | None, seed: int, tell: Callable[[str], None]) -> Refit:
    """Return the refit with its posterior sampled; where an earlier call was interrupted, its sampling is resumed."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / CHECKPOINT if folder is not None else None
    resume = checkpoint is not None and bool(steps_in(checkpoint))
    start = (refit.fit.z, refit.fit.h)
    fit = joint_fit(refit.fit.model, Settings(seed=seed), checkpoint, resume, tell, start)
    return with_fields(refit, fit=fit, objection=objection(fit, refit.delta_chi2))


def apply(result: Result | str | Path, readings: pl.DataFrame | str | Path) -> CalibratedInputs:
    """Return the inputs of a calibrated unit from its outputs, with uncertainty.

    Parameters
    ----------
    result : a fit of the unit, or its folder.
    readings : a table, or a CSV or Parquet file: a column per channel in output units, and
        `converter_temperature_degC` and `temperature_degC` where the model depends on them.

    Raises
    ------
    InputError
        for a result without a posterior, and a table that cannot be read or lacks what the model needs.
    """
    found = result if isinstance(result, Result) else read_result(result)
    if isinstance(readings, pl.DataFrame):
        return apply_calibration(found, readings)
    return apply_calibration(found, read_readings(Path(readings)), str(readings))


def correct(
    result: Result | str | Path,
    recording: str | Path,
    out: str | Path,
    *,
    run: str = "",
    temperatures: Mapping[str, float] | None = None,
    progress: Callable[[str], None] | None = None,
) -> CorrectedRecording:
    """Write a recording with rate and specific force in body axes, solved from all channels jointly, with uncertainty.

    Parameters
    ----------
    result : a fit of the unit, or its folder.
    recording : a CSV or Parquet table with a column per channel, of any length, or a campaign folder.
    out : the table to write, CSV or Parquet.
    run : of the campaign, where it has several.
    temperatures : `temperature` and `converter_temperature` of all rows, °C, where no column gives them.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a result without a posterior, and a recording that cannot be read or lacks what the model needs.
    """
    with progress_of(progress) as tell:
        tell("reading the fit")
        found = result if isinstance(result, Result) else read_result(result)
        source = open_recording(Path(recording), found.fit.model.campaign.channels, run, temperatures)
        tell("correcting")
        return correct_recording(found, source, Path(out), tell)


def onboard_constants(result: Result | str | Path) -> OnboardConstants:
    """Return the constants of a unit to use on board: matrix, biases, gains over temperature, with joint covariance.

    Parameters
    ----------
    result : a fit of the unit, or its folder.

    Raises
    ------
    InputError
        for a result without a posterior, and a unit whose channels do not span three axes.
    """
    return constants_of(result if isinstance(result, Result) else read_result(result))


def export_constants(
    result: Result | str | Path,
    out: str | Path,
    format: Format = "json",
    *,
    noise: str | Path | None = None,
    rate: float | None = None,
    topic: str = "/imu0",
    accept_loss: bool = False,
) -> tuple[Loss, ...]:
    """Write the constants of a unit in the format of another program; return what that format leaves out.

    Parameters
    ----------
    result : a fit of the unit, or its folder.
    out : the file to write.
    format : json, c, kalibr, px4, ardupilot or ros.
    noise : record of `imubayes noise`, for kalibr.
    rate : of the samples on board, Hz, for kalibr.
    topic : ROS topic, for kalibr.
    accept_loss : whether to leave out what is larger than its uncertainty.

    Raises
    ------
    InputError
        where the format cannot hold the constants, or needs what is not known.
    """
    found = result if isinstance(result, Result) else read_result(result)
    constants = constants_of(found)
    known = of_fit(found, constants, rate)
    if noise is not None:
        known |= of_record(read_noise(Path(noise)), found.fit.model.campaign)
    return write_constants(constants, format, Path(out), ExportOptions(rate, topic, known, accept_loss))


def report(result: Result | str | Path, specification: str | Path | None = None) -> QualificationReport:
    """Return the uncertainty report of a result as a record; `imubayes report` writes it as page, PDF and JSON.

    Parameters
    ----------
    result : a result that has a folder, or the folder; its diagnosis and history are read from there.
    specification : file with limits and decision rules; None where nothing is to be decided.

    Raises
    ------
    InputError
        for a result that cannot be read, one whose campaign is gone or has changed, and a specification that cannot be
        used with it.
    """
    return report_of(result, specification)


def history(*folders: str | Path) -> Tree:
    """Return the tree of models tried that result folders stand in."""
    return read_tree(folders)


def load(folder: str | Path) -> Result:
    """Return the result that a folder holds: summary and residuals at once, fit and posterior when they are asked for.

    Raises
    ------
    InputError
        if it is missing, incomplete or damaged; every issue is in it.
    """
    return read_result(folder)


def plant(
    campaign: Campaign | str | Path | None = None,
    model: ModelSpec | str | Path | None = None,
    *,
    result: Result | str | Path | None = None,
    effects: Sequence[str] | None = None,
    size: Size | None = None,
    draws: int = 20,
    seed: int = 0,
    progress: Callable[[str], None] | None = None,
) -> Trials:
    """Inject each effect that the model lacks into data simulated from the fit, and report which are found.

    Parameters
    ----------
    campaign, model : what is fitted first; not needed with a result.
    result : a fit to take instead.
    effects : which to inject; all of the catalogue that the model lacks where None.
    size : how large they are; by default the size with Δχ² = 50.
    draws : simulations without any effect, for the false-alarm rate.
    seed : of the simulations.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for anything that cannot be used, and for free tumbles, which cannot be simulated.
    """
    with progress_of(progress) as tell:
        if result is not None:
            fitted = (result if isinstance(result, Result) else read_result(result)).fit
        elif campaign is None or model is None:
            raise input_error(
                "nothing to inject into", "plant", "a campaign with a model, or a result", "give one of the two"
            )
        else:
            tell("fitting")
            fitted = joint_fit(_bound(campaign, model), None, progress=tell)
        return plant_effects(fitted, effects, size or Size(), draws, seed, tell)


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


__all__ = [
    "Addition",
    "CalibratedInputs",
    "CorrectedRecording",
    "Result",
    "add",
    "apply",
    "correct",
    "diagnose",
    "export",
    "export_constants",
    "fit",
    "history",
    "load",
    "onboard_constants",
    "plant",
    "read_result",
    "report",
]
