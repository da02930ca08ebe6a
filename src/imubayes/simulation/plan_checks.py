"""Validate the steps of planned runs: complete, consistent and applicable to the procedure."""

from imubayes.campaign.named_directions import perpendicular
from imubayes.campaign.toml_documents import Ledger
from imubayes.procedures.planned_steps import OF_ANY_RUN, STEP_KEYS, PlanRules
from imubayes.simulation.test_plan import PlannedRun


def judge_steps(run: PlannedRun, rules: PlanRules, place: int, ledger: Ledger) -> None:
    """Add an issue for every step key that is missing, redundant or not applicable to the procedure."""
    one_of, further = rules.one_of, rules.further
    given = [key for key in STEP_KEYS if getattr(run, key) is not None]
    for key in given:
        if key not in (*one_of, *further, *OF_ANY_RUN):
            ledger.add(
                f"'{key}' does not apply to procedure '{run.procedure}'",
                ("run", place, key),
                ", ".join((*one_of, *further)),
                "remove the key, or correct 'procedure'",
            )
    alternatives = [key for key in one_of if key in given]
    if len(alternatives) != 1:
        ledger.add(
            f"run '{run.name}' of procedure '{run.procedure}' has "
            + (f"both {' and '.join(alternatives)}" if alternatives else f"no '{one_of[0]}'"),
            ("run", place, *alternatives[1:2]),
            ", or ".join(one_of),
            "give exactly one of these keys",
        )
    if "rate_degC_per_h" in further:
        _judge_ramp(run, place, ledger)
    elif "rows" in further and run.rows is None:
        ledger.add(
            f"the number of rows of run '{run.name}' is not given", ("run", place, "rows"), "rows = …", "add 'rows'"
        )
    _judge_directions(run, place, ledger)


def _judge_directions(run: PlannedRun, place: int, ledger: Ledger) -> None:
    for index, pair in enumerate(run.directions or ()):
        if len(pair) != 2 or not perpendicular(pair):
            ledger.add(
                f"'{pair}' does not name two perpendicular directions",
                ("run", place, "directions", index),
                "two of the letters E W N S U D: the input axis, then the output axis, such as 'EN'",
                "correct the letters",
            )


def _judge_ramp(run: PlannedRun, place: int, ledger: Ledger) -> None:
    ramp = run.converter_temperature_degC
    rising = ramp is not None and ramp[0] != ramp[1]
    timed = run.rate_degC_per_h is not None and run.seconds_per_row is not None
    if run.rate_degC_per_h is not None and not rising:
        ledger.add(
            f"run '{run.name}' has a temperature rate but no temperature change",
            ("run", place, "rate_degC_per_h"),
            "converter_temperature_degC = [from, to] with two different values",
            "give both ends of the ramp, or leave 'rate_degC_per_h' out",
        )
    elif timed and run.rows is not None:
        ledger.add(
            f"the duration of run '{run.name}' is overdetermined",
            ("run", place, "rows"),
            "two of rows, rate_degC_per_h and seconds_per_row",
            "remove one of the three",
        )
    elif not timed and run.rows is None:
        ledger.add(
            f"the number of rows of run '{run.name}' is not given",
            ("run", place, "rows"),
            "rows = …, or both rate_degC_per_h and seconds_per_row",
            "add 'rows'",
        )
