"""Whether a plan says of each run what its procedure asks for, once and not twice."""

from imubayes.campaign.toml_documents import Ledger
from imubayes.procedures.planned_steps import STEP_KEYS, PlanRules
from imubayes.simulation.test_plan import PlannedRun


def judge_steps(run: PlannedRun, rules: PlanRules, place: int, ledger: Ledger) -> None:
    """Note what a run of a known procedure says too much or too little of what is done."""
    one_of, further = rules.one_of, rules.further
    given = [key for key in STEP_KEYS if getattr(run, key) is not None]
    for key in given:
        if key not in one_of + further:
            ledger.add(
                f"'{key}' means nothing in a run of procedure '{run.procedure}'",
                ("run", place, key),
                ", ".join((*one_of, *further)),
                "remove the key, or correct 'procedure'",
            )
    asked = [key for key in one_of if key in given]
    if len(asked) != 1:
        ledger.add(
            f"run '{run.name}' of procedure '{run.procedure}' has "
            + (f"both {' and '.join(asked)}" if asked else f"no '{one_of[0]}'"),
            ("run", place, *asked[1:2]),
            ", or ".join(one_of),
            "say what is done in one way",
        )
    if "rows" in further:
        _judge_ramp(run, place, ledger)


def _judge_ramp(run: PlannedRun, place: int, ledger: Ledger) -> None:
    ramp = run.converter_temperature_degC
    rising = ramp is not None and ramp[0] != ramp[1]
    timed = run.rate_degC_per_h is not None and run.seconds_per_row is not None
    if run.rate_degC_per_h is not None and not rising:
        ledger.add(
            f"run '{run.name}' has a rate of temperature and no change of it",
            ("run", place, "rate_degC_per_h"),
            "converter_temperature_degC = [from, to] with two different values",
            "give both ends of the ramp, or leave 'rate_degC_per_h' out",
        )
    elif timed and run.rows is not None:
        ledger.add(
            f"run '{run.name}' says twice how long it lasts",
            ("run", place, "rows"),
            "two of rows, rate_degC_per_h and seconds_per_row",
            "leave one of the three out",
        )
    elif not timed and run.rows is None:
        ledger.add(
            f"run '{run.name}' does not say how many rows it has",
            ("run", place, "rows"),
            "rows = …, or both rate_degC_per_h and seconds_per_row",
            "add 'rows'",
        )
