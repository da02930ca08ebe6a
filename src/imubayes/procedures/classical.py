"""Textbook estimates of a campaign, procedure by procedure, for comparison with the joint fit."""

from imubayes.campaign_data import Campaign
from imubayes.procedures import PROCEDURES
from imubayes.procedures.textbook import TextbookResult


def classical(campaign: Campaign) -> tuple[TextbookResult, ...]:
    """Return the textbook estimates of a campaign, and the quantities that the textbook methods cannot determine."""
    found: list[TextbookResult] = []
    for evaluate in dict.fromkeys(procedure.evaluate for procedure in PROCEDURES.values()):
        runs = [run for run in campaign.runs if PROCEDURES[run.procedure].evaluate is evaluate]
        found += evaluate(campaign, runs) if evaluate and runs else []
    return tuple(found)
