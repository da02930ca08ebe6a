"""The test procedures, one module and one line of registration each, and the textbook estimates of a campaign.

Estimates and standard combinations are found procedure by procedure.
"""

from collections.abc import Iterator, Mapping, MutableMapping
from dataclasses import replace
from importlib import import_module

from imubayes.foundations.campaign_data import Campaign
from imubayes.procedures.base import Procedure, Reduction
from imubayes.procedures.fitted_terms import StandardCombination
from imubayes.procedures.textbook import TextbookResult

_MODULES = {
    "rate_table": "rate_table",
    "rotation_modulation": "rotation_modulation",
    "dividing_head": "dividing_head",
    "polar_tumble": "polar_tumble",
    "geographic_tumble": "geographic_tumble",
    "servo_table": "servo_table",
    "thermal_ramp": "converter_temperature",
    "current_injection": "converter_temperature",
    "reference_gyro": "reference_gyro",
    "multi_axis_table": "multi_axis_table",
    "centrifuge": "centrifuge",
    "free_tumble": "free_tumble",
    "slow_motion": "slow_motion",
    "free_rotation": "free_rotation",
    "static_record": "static_record",
}
"""Name → module, which has the procedure in capital letters: a campaign loads those that it names."""


class _Procedures(MutableMapping[str, Procedure]):
    """The procedures by name, each loaded when it is first asked for."""

    def __init__(self, modules: Mapping[str, str]):
        self._known: dict[str, Procedure | str] = dict(modules)

    def __getitem__(self, name: str) -> Procedure:
        found = self._known[name]
        if isinstance(found, str):
            found = self._known[name] = getattr(import_module(f"{__name__}.{found}"), name.upper())
        return found

    def __setitem__(self, name: str, procedure: Procedure) -> None:
        self._known[name] = procedure

    def __delitem__(self, name: str) -> None:
        del self._known[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self._known)

    def __len__(self) -> int:
        return len(self._known)

    def __contains__(self, name: object) -> bool:
        return name in self._known


PROCEDURES = _Procedures(_MODULES)
"""Name → procedure."""


def procedure_named(name: str) -> Procedure:
    """Return a procedure by its name; one without any requirement if the name is unknown."""
    return PROCEDURES.get(name) or Procedure(name)


def _of_runs(campaign: Campaign) -> Iterator[tuple[str, Procedure]]:
    """Yield the procedures of the runs of a campaign, in the order of the table."""
    named = {run.procedure for run in campaign.runs}
    return ((name, PROCEDURES[name]) for name in PROCEDURES if name in named)


def classical(campaign: Campaign, delta_k_threshold: float | None = None) -> tuple[TextbookResult, ...]:
    """Return the textbook estimates of a campaign, and the quantities that the textbook methods cannot determine.

    Parameters
    ----------
    delta_k_threshold : largest Δk at which the 1 g line of a converter applies to another input, as a ratio; that of
        the campaign if None.
    """
    if delta_k_threshold is not None:
        campaign = replace(campaign, delta_k_threshold=delta_k_threshold)
    found: list[TextbookResult] = []
    for evaluate in dict.fromkeys(procedure.evaluate for _, procedure in _of_runs(campaign)):
        runs = [run for run in campaign.runs if PROCEDURES[run.procedure].evaluate is evaluate]
        found += evaluate(campaign, runs) if evaluate and runs else []
    return tuple(found)


def declared_combinations(campaign: Campaign) -> tuple[StandardCombination, ...]:
    """Return the standard combinations that the procedures of a campaign declare, each name once."""
    found: dict[str, StandardCombination] = {}
    for name, procedure in _of_runs(campaign):
        runs = [run for run in campaign.runs if run.procedure == name]
        for each in procedure.combinations(campaign, runs) if procedure.combinations else []:
            found.setdefault(each.name, each)
    return tuple(found.values())


__all__ = ["PROCEDURES", "Procedure", "Reduction", "classical", "declared_combinations", "procedure_named"]
