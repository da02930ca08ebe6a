"""Textbook estimates of a campaign, procedure by procedure, for comparison with the joint fit."""

from dataclasses import replace

from imubayes.campaign_data import Campaign
from imubayes.procedures import PROCEDURES
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
