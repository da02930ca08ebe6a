"""The population of an archive as the prior of a unit that is not among its units."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import polars as pl

from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import input_error
from imubayes.model.bind import bind
from imubayes.model.model_file import ModelSpec
from imubayes_archive.dataset.campaign_file import unit_of
from imubayes_archive.population.hierarchical_fit import hierarchical_fit
from imubayes_archive.population.population_priors import known_priors, with_priors
from imubayes_archive.unit_fits.posterior_table import chosen_model, read_outcomes


def given_archive(
    spec: ModelSpec, results: str | Path, campaign: Campaign, progress: Callable[[str], None] = lambda _: None
) -> ModelSpec:
    """Return a model with the population of a batch as its priors.

    Parameters
    ----------
    spec : the model of the campaign; parameters that the batch lacks keep their priors.
    results : results folder of a batch of one model.
    campaign : the campaign that is to be fitted.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a folder without results, a campaign that is one of the batch, and a model that shares no parameter with it.
    """
    outcomes = read_outcomes(results, chosen_model(results, None))
    same = outcomes.filter((pl.col("unit") == unit_of(campaign)) & (pl.col("campaign") == campaign.name))
    if same.height:
        raise input_error(
            f"the campaign '{campaign.name}' is one of those that the population is from",
            str(results),
            "a campaign that is not among them: its data would count twice",
            "imubayes batch population FOLDER --out units.parquet gives each of its units with the others as prior",
        )
    found = hierarchical_fit(results, progress=progress).populations
    mine = bind(spec, campaign)
    names = [*mine.layout.names, *mine.hyper_layout.names]
    known = {name: each for name, each in known_priors(found).items() if name in names}
    model, replaced = with_priors(spec, known, names)
    if not replaced:
        raise input_error(
            "no parameter of this campaign has a population",
            str(results),
            "a batch of units like this one",
            "see them with `imubayes batch population`, or leave --population out",
        )
    return replace(model, priors_from=f"the population of {found.units} units in {results}")
