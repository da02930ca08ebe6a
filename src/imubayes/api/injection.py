"""Inject effects into simulated data, and see which are found."""

from collections.abc import Callable, Sequence
from pathlib import Path

from imubayes.api.fitting import bound
from imubayes.campaign_data import Campaign
from imubayes.display.notebook_progress import progress_of
from imubayes.errors import input_error
from imubayes.inference.run_fit import joint_fit
from imubayes.loop.injection_recovery import Size, Trials, plant_effects
from imubayes.model.model_spec import ModelSpec
from imubayes.results.result import Result, read_result


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
            fitted = joint_fit(bound(campaign, model), None, progress=tell)
        return plant_effects(fitted, effects, size or Size(), draws, seed, tell)
