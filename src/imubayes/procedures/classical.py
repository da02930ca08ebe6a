"""Textbook estimates and standard combinations of a campaign, procedure by procedure."""

from dataclasses import replace

from imubayes.campaign_data import Campaign
from imubayes.procedures import PROCEDURES
from imubayes.procedures.standard_combinations import StandardCombination
from imubayes.procedures.textbook import TextbookResult


def classical(campaign: Campaign, delta_k_threshold: float | None = None) -> tuple[TextbookResult, ...]:
    """Return the textbook estimates of a campaign, and the quantities that the textbook methods cannot determine.

    Parameters
    ----------
    delta_k_threshold : largest Δk at which the 1 g line of a converter applies to another input, as a ratio; that of
        the campaign where None.
    """
    if delta_k_threshold is not None:
        campaign = replace(campaign, delta_k_threshold=delta_k_threshold)
    found: list[TextbookResult] = []
    for evaluate in dict.fromkeys(procedure.evaluate for procedure in PROCEDURES.values()):
        runs = [run for run in campaign.runs if PROCEDURES[run.procedure].evaluate is evaluate]
        found += evaluate(campaign, runs) if evaluate and runs else []
    return tuple(found)


def declared_combinations(campaign: Campaign) -> tuple[StandardCombination, ...]:
    """Return the standard combinations that the procedures of a campaign declare, each name once."""
    found: dict[str, StandardCombination] = {}
    for name, procedure in PROCEDURES.items():
        runs = [run for run in campaign.runs if run.procedure == name]
        for each in procedure.combinations(campaign, runs) if procedure.combinations and runs else []:
            found.setdefault(each.name, each)
    return tuple(found.values())
