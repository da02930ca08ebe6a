"""Fit a campaign, or load the result of a fit."""

import time
from collections.abc import Callable
from dataclasses import replace as with_fields
from pathlib import Path
from typing import Any, Literal

from imubayes.campaign import load_campaign
from imubayes.display.progress import progress_of
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import Issue, refuse
from imubayes.foundations.extensions import answer_to, extensions
from imubayes.inference.chains import Settings
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import ModelSpec, read_model
from imubayes.results.fit_file import node_of
from imubayes.results.folder_files import CHECKPOINT
from imubayes.results.folder_state import claimed
from imubayes.results.result import Result, read_result, result_of
from imubayes.results.result_folder import write_result

# What only a sampled fit needs.
posterior_quantities: Any = DeferredModule("imubayes.results.posterior_quantities")


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
    until_digits: Literal[1, 2] | None = None,
    population: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Result:
    """Fit all runs of a campaign jointly and sample the posterior.

    Parameters
    ----------
    campaign : a campaign, or its folder.
    model : a model, its file, or the name of a shipped one.
    out : result folder to write; None for none.
    sample : whether to sample, or to stay with the Laplace approximation.
    seed, settings : of the sampler.
    resume : continue the checkpoint in `out`.
    replace : whether a sampled result in `out` may be replaced; one that was not sampled always is.
    until_digits : significant digits of every standard uncertainty to sample for (JCGM 101, 7.9.4), as memory allows.
    population : results folder of a batch whose population is the prior of this unit.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for anything that cannot be used; nothing is written then.

    Examples
    --------
    >>> import imubayes
    >>> result = imubayes.fit("data/accel-channel", "accel-channel", sample=False)
    >>> round(result["converter_gain_drift.slope[ax]"].mean, 1)  # ppm/degC
    -3.2
    """
    clock = time.perf_counter()
    declared = bound(campaign, model, population, progress)
    load_seconds = time.perf_counter() - clock
    folder = Path(out) if out is not None else None
    checkpoint = _checkpoint(declared, folder)
    sampling = with_fields(settings or Settings(), seed=seed) if sample else None
    with claimed(folder, resume, replace), progress_of(progress) as tell:
        if until_digits is not None:
            fitted = posterior_quantities.fit_until_digits(declared, sampling, until_digits, checkpoint, resume, tell)
        else:
            fitted = joint_fit(declared, sampling, checkpoint, resume, tell)
        tell("summarising")
        result = result_of(fitted, folder, seed, load_seconds)
        if folder is not None:
            result = write_result(result, node_of(fitted.model, result.summary, seed))
        if folder is not None and sample:
            keep_beside(result, tell)
    return result


def keep_beside(result: Result, progress: Callable[[str], None]) -> None:
    """Let the packages beside the kernel keep their own in the folder of a sampled result, while its model is compiled.

    The quick fits of the loop leave that to the commands that need it.
    """
    for name, entry in extensions("results").items():
        progress(name)
        entry.load()(result)


def _checkpoint(model: Model, folder: Path | None) -> Path | None:
    """Return the file that sampling is resumed from; raise if data or effects are in no file to read again."""
    if folder is None:
        return None
    issues = [
        Issue(
            f"the effect '{member.__name__}' is defined in this session, and a result reads it from a file",
            "out", "effect files of the model", "write the class to a file, and name it under 'files' of the model",
        )
        for member in model.spec.classes
    ]  # fmt: skip
    if not model.campaign.folder:
        remedy = "give build_campaign a folder, which it writes; without out the result stays in memory"
        what = f"the campaign '{model.campaign.name}' is in no folder, from which a result could read its data"
        issues.append(Issue(what, "out", "a campaign that is in a folder", remedy))
    refuse(issues)
    return folder / CHECKPOINT


def load(folder: str | Path) -> Result:
    """Return the result in a folder: summary and residuals at once, fit and posterior when they are accessed.

    Parameters
    ----------
    folder : the result folder.

    Raises
    ------
    InputError
        if it is missing, incomplete or damaged; every issue is in it.

    Examples
    --------
    >>> import imubayes
    >>> result = imubayes.load("results/accel-channel")
    >>> result.converged, result.summary.campaign
    (True, 'accel-channel')
    """
    return read_result(folder)


def bound(
    campaign: Campaign | str | Path,
    model: ModelSpec | str | Path,
    population: str | Path | None = None,
    progress: Callable[[str], None] | None = None,
) -> Model:
    """Return a model bound to a campaign, each read from its file if it is not in memory.

    Its priors are the population of a batch if the results folder of one is given.
    """
    loaded = campaign if isinstance(campaign, Campaign) else load_campaign(campaign)
    spec = model if isinstance(model, ModelSpec) else read_model(model)
    if population is not None:
        with progress_of(progress) as tell:
            spec = answer_to("fit.population")(spec, population, loaded, tell)
    return bind(spec, loaded)
