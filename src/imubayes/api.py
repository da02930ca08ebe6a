"""The Python interface: the same words as on the command line."""

import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import imubayes.display.presentation  # noqa: F401  (records learn how to show themselves)
from imubayes.campaign import load_campaign
from imubayes.criticism.diagnosis import Diagnosis, judge
from imubayes.inference.ensemble_sampling import Settings
from imubayes.inference.fit import Fit
from imubayes.inference.joint_fit import joint_fit
from imubayes.loop import Addition, add, history, plant
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.model.model_spec import ModelSpec
from imubayes.procedures import PROCEDURES
from imubayes.results.folder_state import CHECKPOINT, claim
from imubayes.results.history_file import first_node, write_node
from imubayes.results.result import Result, read_result, result_of
from imubayes.run import Campaign


def fit(
    campaign: Campaign | str | Path,
    model: ModelSpec | str | Path,
    out: str | Path | None = None,
    *,
    sample: bool = True,
    seed: int = 0,
    resume: bool = False,
    settings: Settings | None = None,
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
    settings : of the sampler, beyond the seed.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for anything that cannot be used; nothing is written then.
    """
    clock = time.perf_counter()
    campaign = campaign if isinstance(campaign, Campaign) else load_campaign(campaign, tuple(PROCEDURES))
    model = model if isinstance(model, ModelSpec) else read_model(model)
    declared = bind(model, campaign)
    load_seconds = time.perf_counter() - clock
    folder = Path(out) if out is not None else None
    checkpoint = folder / CHECKPOINT if folder is not None else None
    if folder is not None:
        claim(folder, resume)
    sampling = replace(settings or Settings(), seed=seed) if sample else None
    fitted = joint_fit(declared, sampling, checkpoint, resume, progress)
    result = result_of(fitted, folder, seed, load_seconds)
    if folder is not None:
        write_node(folder, first_node(fitted.model, result.summary, seed))
    return result


def diagnose(result: Result | Fit | str | Path, effect: str = "") -> Diagnosis:
    """Return which physical effect is missing in a fit, or that none is, from one pass and without a refit.

    Parameters
    ----------
    result : a result, its folder, or a fitted model.
    effect : ask about this effect alone.

    Raises
    ------
    InputError
        for a folder that holds no result, or one whose campaign is gone or has changed.
    """
    if isinstance(result, Fit):
        return judge(result, effect=effect)
    found = result if isinstance(result, Result) else read_result(result)
    return judge(found.fit, str(found.folder or "RESULT"), effect)


__all__ = ["Addition", "Result", "add", "diagnose", "fit", "history", "plant", "read_result"]
