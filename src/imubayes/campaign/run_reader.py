"""Read one run: from its table file to a `Run` with rows in SI, with all issues and findings.

A run table has one of three forms: rows of means (with a `samples` column), a raw log to be reduced, or the raw log of
a free tumble, whose rotations are observations as well.  Columns are in the units of the file until the `Run` is built.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from imubayes.campaign.axis_directions import DIRECTION_COLUMNS, attitudes
from imubayes.campaign.column_layout import TEXT_COLUMNS, ColumnLayout, lay_out
from imubayes.campaign.equipment import BenchSettings
from imubayes.campaign.file_schemas import RunEntry
from imubayes.campaign.physical_checks import check_clock, check_log, check_rest, check_rows
from imubayes.campaign.run_tables import TableFile, TableSource, read_header, refuse_long
from imubayes.campaign.sample_checks import without_counts
from imubayes.campaign.stream_checks import UNIT_FINDINGS, Finding, Monitor
from imubayes.foundations.campaign_data import Channel, Mounting, Run, Site, Table, Thermometer, Tumble
from imubayes.foundations.covariates import recorded
from imubayes.foundations.deferred_modules import DeferredModule
from imubayes.foundations.errors import InputError, Issue, input_error
from imubayes.procedures import PROCEDURES, Procedure, Reduction, procedure_named

if TYPE_CHECKING:
    from imubayes.campaign import reduction as reduce
else:
    reduce = DeferredModule("imubayes.campaign.reduction")  # only raw logs need it

TURN = 2 * np.pi


def build_run(
    entry: RunEntry,
    numbers: Mapping[str, np.ndarray],
    channels: Sequence[Channel],
    gravity: float,
    notes: Sequence[str] = (),
    tumble: Tumble | None = None,
    attitude: np.ndarray | None = None,
) -> Run:
    """Return a run from its rows.

    Parameters
    ----------
    entry : the run's entry in the campaign file.
    numbers : column → shape (R,), in the units of the file; `samples` and `<channel>_sd` if available.
    channels : all channels of the campaign.
    gravity : of the site, m/s².
    notes : from the reduction.
    tumble : the rotations of a free tumble.
    attitude : shape (R, 3, 3), if the rows give directions.
    """
    rows = len(next(iter(numbers.values())))
    unknown = np.full(rows, np.nan)
    covariates, covariate_notes = _covariates(entry, numbers, rows, gravity)
    return Run(
        entry.name,
        entry.procedure,
        entry.table,
        entry.mounting,
        covariates,
        np.stack([numbers.get(channel.name, unknown) for channel in channels], axis=1),
        numbers.get("samples", np.ones(rows)),
        np.stack([numbers.get(f"{channel.name}_sd", unknown) for channel in channels], axis=1),
        None if entry.start is None else entry.start.isoformat(),
        tumble,
        attitude,
        (*notes, *covariate_notes),
        entry.temperature_uncertainty_degC,
        entry.converter_temperature_uncertainty_degC,
        None if entry.turn_uncertainty_deg is None else float(np.radians(entry.turn_uncertainty_deg)),
        entry.thermometer,
        entry.converter_thermometer,
    )


def unused_columns(layout: ColumnLayout, procedure: Procedure, run: str, where: str) -> list[Finding]:
    """Return a warning for known columns that are not used in the rows."""
    used = {"segment", *(DIRECTION_COLUMNS if procedure.by_direction else ())}
    unused = [name for name in TEXT_COLUMNS if layout.has(name) and name not in used]
    if not unused:
        return []
    what = f"{', '.join(unused)}: read and checked, not used"
    return [
        Finding("unused_columns", "warning", run, what, f"{where}, header", "", "nothing; the other columns are used")
    ]


def unfounded_uncertainties(entry: RunEntry, run: Run, where: str) -> list[Finding]:
    """Return an error for each uncertainty or thermometer of a temperature that the run neither states nor records."""
    stated = {
        "temperature_uncertainty_degC": ("temperature", entry.temperature_uncertainty_degC),
        "converter_temperature_uncertainty_degC": (
            "converter_temperature", entry.converter_temperature_uncertainty_degC,
        ),
        "thermometer": ("temperature", entry.thermometer),
        "converter_thermometer": ("converter_temperature", entry.converter_thermometer),
    }  # fmt: skip
    return [
        Finding(
            "unfounded_uncertainty", "error", entry.name,
            f"{key} is stated without {name}_degC",
            f"{where}, header", f"{name}_degC of the run, or a column of that name with values",
            f"state {name}_degC, or remove {key}",
        )
        for key, (name, value) in stated.items()
        if value and name not in run.covariates
    ]  # fmt: skip


def _covariates(
    entry: RunEntry, numbers: Mapping[str, np.ndarray], rows: int, gravity: float
) -> tuple[dict[str, np.ndarray], list[str]]:
    covariates = {
        covariate.name: numbers[covariate.column] * covariate.factor(gravity)
        for covariate in recorded()
        if covariate.column in numbers
    }
    notes: list[str] = []
    procedure = PROCEDURES[entry.procedure]
    rate = covariates.setdefault("table_rate", np.zeros(rows))
    # With a reference gyro the table rate is not recorded, and any row may turn.
    turning = (rate != 0) | (not procedure.rate_recorded)
    angle = covariates.get("table_angle")
    if angle is None:
        if procedure.needs_table and not turning.all():
            notes.append("no angle column: table angle 0 is assumed at rest")
        angle = np.full(rows, np.nan)
    elif np.any(np.isnan(angle) & ~turning):
        notes.append(f"{np.sum(np.isnan(angle) & ~turning)} empty angles at rest are set to 0")
    covariates["table_angle"] = np.where(np.isnan(angle) & ~turning, 0.0, angle)
    span = covariates.get("table_angle_span", np.full(rows, np.nan))
    whole = np.where(np.isnan(covariates["table_angle"]), TURN, 0.0)
    covariates["table_angle_span"] = np.where(np.isnan(span), whole, span)
    stated = {"temperature": entry.temperature_degC, "converter_temperature": entry.converter_temperature_degC}
    for name, of_run in stated.items():
        _fill_temperature(name, covariates, of_run, rows, notes)
    return covariates, notes


def _fill_temperature(
    name: str, covariates: dict[str, np.ndarray], of_run: float | None, rows: int, notes: list[str]
) -> None:
    values = covariates.get(name)
    if values is not None and np.isnan(values).all():
        del covariates[name]
        values = None
    if values is None:
        if of_run is not None:
            covariates[name] = np.full(rows, of_run)
        return
    empty = np.isnan(values)
    if empty.any():
        axis = covariates.get("time", np.arange(rows, dtype=float))
        covariates[name] = np.where(empty, np.interp(axis, axis[~empty], values[~empty]), values)
        notes.append(f"{np.sum(empty)} missing values of {name} are interpolated linearly")


ANGLE_COLUMN, RATE_COLUMN = "table_angle_deg", "table_rate_deg_s"
_MOST_LEVELS = 2
"""Unsteady levels that a warning names."""
_MOST_SAMPLES = 1e12
"""Raw samples of one row: a thousand seconds at a gigahertz."""


@dataclass(frozen=True)
class Equipment:
    """The equipment that a run is checked against."""

    site: Site
    channels: tuple[Channel, ...]
    tables: dict[str, Table]
    mountings: dict[str, Mounting]
    benches: dict[str, BenchSettings]
    thermometers: dict[str, Thermometer]


@dataclass
class Loaded:
    """Result of loading one run: the run if usable, issues of the file, findings in the data."""

    run: Run | None = None
    issues: list[Issue] = field(default_factory=list)
    findings: list[Finding] = field(default_factory=list)

    @property
    def readable(self) -> bool:
        """Whether nothing but a unit or a rate is wrong: all runs together show the right one."""
        wrong = {finding.name for finding in self.findings if finding.severity == "error"}
        return not self.issues and wrong <= {*UNIT_FINDINGS}


@dataclass(frozen=True)
class _Survey:
    rows: int
    blocks: "reduce.BlockSurvey | None"
    labelled: "list[reduce.Span] | None"
    findings: list[Finding]
    limits: "reduce.Limits"


def load_run(file: TableFile, entry: RunEntry, channel_names: Sequence[str], equipment: Equipment | None) -> Loaded:
    """Read one run table; `judge_rows` checks what it holds.

    Parameters
    ----------
    file : the table.
    entry : the run's entry in the campaign file.
    channel_names : the channels that may have a column.
    equipment : of the campaign; None if invalid, in which case only the file itself is checked.
    """
    loaded = Loaded()
    try:
        layout, loaded.issues = lay_out(
            read_header(file), channel_names, entry.ignore, procedure_named(entry.procedure), str(file)
        )
        if loaded.issues:
            return loaded
        _load(loaded, TableSource(file, layout), entry, equipment)
    except InputError as error:
        loaded.issues += error.issues
    return loaded


def _load(loaded: Loaded, source: TableSource, entry: RunEntry, equipment: Equipment | None) -> None:
    survey = _survey(source, entry)
    where = str(source.file)
    loaded.findings += survey.findings
    if not source.layout.reduced:
        loaded.findings += without_counts(entry.name, [n for n in source.layout.numbers if n.endswith("_sd")], where)
    if survey.rows == 0:
        loaded.findings.append(_empty(entry, where, "the table has a header and no rows"))
    if not loaded.readable or equipment is None:
        return
    run, found = _rows_of(source, entry, equipment, survey)
    loaded.findings += found
    if run.rows == 0:
        loaded.findings.append(_empty(entry, where, "no interval of constant stimulus was found in the log"))
    elif loaded.readable:
        loaded.findings += unfounded_uncertainties(entry, run, where)
    if loaded.readable:
        loaded.findings += unused_columns(source.layout, PROCEDURES[entry.procedure], entry.name, where)
        loaded.run = run


def judge_rows(loaded: Loaded, entry: RunEntry, equipment: Equipment, where: str) -> None:
    """Check the rows of a loaded run, without those that were left out; warnings become its notes.

    Parameters
    ----------
    loaded : changed in place; its run becomes None if an error makes it unusable.
    where : the table, for the findings.
    """
    try:
        _judge(loaded, entry, equipment, where)
    except InputError as error:
        loaded.issues += error.issues
        loaded.run = None


def _judge(loaded: Loaded, entry: RunEntry, equipment: Equipment, where: str) -> None:
    run = loaded.run
    if run is None:
        return
    if not PROCEDURES[entry.procedure].driven and not np.isfinite(run.observed).any():
        loaded.findings.append(_empty(entry, where, "no channel has a value in any row"))
    else:
        table, mounting = equipment.tables.get(entry.table or ""), equipment.mountings.get(entry.mounting or "")
        loaded.findings += check_rows(run, equipment.channels, equipment.site, table, mounting, where)
    warnings = tuple(f"{f.name}: {f.what}" for f in loaded.findings if f.severity == "warning")
    loaded.run = replace(run, notes=(*run.notes, *warnings)) if loaded.readable else None


def _rows_of(source: TableSource, entry: RunEntry, equipment: Equipment, survey: _Survey) -> tuple[Run, list[Finding]]:
    """Return the run and its findings, according to its form: static poses, means, or a raw log to be reduced."""
    reduction = PROCEDURES[entry.procedure].reduction
    _refuse_keys(source, entry, survey)
    if reduction.by_hand:
        return _load_tumble(source, entry, equipment, survey.limits)
    gravity = equipment.site.gravity
    bench = equipment.benches.get(entry.table or "", BenchSettings())
    if source.layout.reduced:
        numbers = _from_zero(source.whole(), source, bench)
        attitude = _attitude(source, entry, equipment, range(survey.rows))
        run = build_run(entry, numbers, equipment.channels, gravity, attitude=attitude)
        return run, _check_counts(numbers, source, entry)
    assert survey.blocks is not None
    where = str(source.file)
    reduce.refuse_impossible_rate(survey.blocks.interval, where)
    momentary = entry.transitions or reduction is Reduction.FOLLOWED
    found = check_log(survey.blocks, entry.name, where)
    if not PROCEDURES[entry.procedure].driven:
        found += check_clock(survey.blocks, entry.name, equipment.channels, where, momentary)
    rows = reduce.reduce_log(
        source, reduction, survey.rows, survey.blocks, survey.labelled, survey.limits, bench, entry.transitions
    )
    numbers = _from_zero(rows.numbers, source, bench)
    attitude = _attitude(source, entry, equipment, rows.first)
    found += [_unsteady(entry, where, rows.unsteady)] if rows.unsteady else []
    found += [_unsettled(entry, where, rows.unsettled)] if rows.unsettled else []
    run = build_run(entry, numbers, equipment.channels, gravity, rows.notes, attitude=attitude)
    return run, [*found, *check_rest(survey.blocks, run, equipment.channels, where)]


def _refuse_keys(source: TableSource, entry: RunEntry, survey: _Survey) -> None:
    """Raise where keys of a run and its columns do not belong together."""
    if entry.transitions:
        _refuse_transitions(source, entry, survey)
    elif PROCEDURES[entry.procedure].followed and not source.layout.has(RATE_COLUMN):
        raise input_error(
            f"a run of procedure '{entry.procedure}' needs the column '{RATE_COLUMN}'",
            f"{source.file}, header", f"{RATE_COLUMN}; or transitions = true, of a raw log with {ANGLE_COLUMN}",
            "add the column, write transitions = true in the run, or correct 'procedure' of the run",
        )  # fmt: skip
    if entry.turn_uncertainty_deg is not None and not _may_turn(source, entry):
        raise input_error(
            f"run '{entry.name}' states turn_uncertainty_deg, but has no turns",
            str(source.file), "turn_uncertainty_deg for rows of a rate table, each a turn or a rest", "remove the key",
        )  # fmt: skip


def _may_turn(source: TableSource, entry: RunEntry) -> bool:
    """Tell whether the rows of a run are means, some of which may be turns from rest to rest."""
    return PROCEDURES[entry.procedure].reduction is Reduction.CONSTANT and source.layout.reduced


def _refuse_transitions(source: TableSource, entry: RunEntry, survey: _Survey) -> None:
    """Raise where the motion of a table cannot be followed."""
    where, blocks = str(source.file), survey.blocks
    if not PROCEDURES[entry.procedure].followed:
        raise input_error(
            f"rows of procedure {entry.procedure} in run '{entry.name}' do not follow a motion",
            where, "transitions = true for a run of rate_table, on a table of one axis",
            "remove the key; on several axes move one, hold the others, and state a [[table]] of the one that moves",
        )  # fmt: skip
    if source.layout.reduced or not source.layout.has(ANGLE_COLUMN) or blocks is None or blocks.interval is None:
        raise input_error(
            f"the rate between the levels of run '{entry.name}' is unknown",
            where, f"a raw log with time_s and {ANGLE_COLUMN} for transitions = true: a rate column may be a command",
            "record the angle of the encoder, or remove the key",
        )  # fmt: skip
    if survey.labelled is not None:
        raise input_error(
            f"run '{entry.name}' has a column 'segment', which says which rows are used",
            where, "transitions = true for a log without labels", "remove the key, or the column",
        )  # fmt: skip


def _attitude(source: TableSource, entry: RunEntry, equipment: Equipment, rows: Sequence[int]) -> np.ndarray | None:
    """Return the attitude given by the directions of the rows, (len(rows), 3, 3); None if rows give no directions."""
    return attitudes(source, rows, equipment.channels) if PROCEDURES[entry.procedure].by_direction else None


def _survey(source: TableSource, entry: RunEntry) -> _Survey:
    poses = procedure_named(entry.procedure).reduction.by_hand
    monitor = Monitor(source, entry.name, all_move=poses)
    tracker = None if source.layout.reduced else _segment_tracker(source)
    builder = None
    if source.layout.reduced or poses:
        refuse_long(source.file, len(source.layout.numbers))
    else:
        builder = reduce.BlockBuilder([name for name in source.layout.numbers if not name.endswith("_sd")])
    consumers = [consumer for consumer in (monitor, builder, tracker) if consumer is not None]
    for batch in source:
        if batch.rows:
            for consumer in consumers:
                consumer.push(batch)
    blocks = builder.finish() if builder is not None and monitor.rows else None
    labelled = None if tracker is None else tracker.spans()
    return _Survey(monitor.rows, blocks, labelled, monitor.findings(), monitor.limits())


def _segment_tracker(source: TableSource) -> "reduce.SegmentTracker | None":
    labels = [name for name in ("segment", *DIRECTION_COLUMNS) if name in source.layout.texts]
    return reduce.SegmentTracker(labels) if labels else None


def _load_tumble(
    source: TableSource, entry: RunEntry, equipment: Equipment, limits: "reduce.Limits"
) -> tuple[Run, list[Finding]]:
    gravity, channels = equipment.site.gravity, equipment.channels
    reduced = reduce.reduce_by_hand(source, entry, channels, gravity, limits)
    run = build_run(entry, reduced.numbers, channels, gravity, reduced.notes, reduced.tumble)
    findings = [replace(finding, run=entry.name) for finding in reduced.findings]
    return run, findings


def _check_counts(numbers: dict[str, np.ndarray], source: TableSource, entry: RunEntry) -> list[Finding]:
    count = numbers["samples"]
    wrong = [
        ("samples", ~(count >= 1), "are below 1", "1 or more"),
        ("samples", count > _MOST_SAMPLES, f"are above {_MOST_SAMPLES:g}", "how many raw samples the row is a mean of"),
        (
            "samples",
            (count >= 1) & (count != np.floor(count)),
            "are not whole numbers",
            "a whole number of raw samples",
        ),
    ]
    spreads = [name for name in numbers if name.endswith("_sd")]
    wrong += [(name, numbers[name] < 0, "are negative", "0 or more") for name in spreads]
    return [
        Finding(
            "bad_count", "error", entry.name,
            f"{int(rows.sum())} cells of '{name}' {what}, the first is {numbers[name][np.argmax(rows)]:.12g}",
            f"{source.place(int(np.argmax(rows)))}, column '{name}'", allowed, "correct the cell",
        )
        for name, rows, what, allowed in wrong if rows.any()
    ]  # fmt: skip


def _empty(entry: RunEntry, where: str, what: str) -> Finding:
    allowed = "rows with outputs; for a raw log, at least one second of constant stimulus"
    return Finding("empty_run", "error", entry.name, what, where, allowed, "fill the table or remove the run")


def _from_zero(numbers: dict[str, np.ndarray], source: TableSource, bench: BenchSettings) -> dict[str, np.ndarray]:
    """Return the columns with the angle of the table counted from its zero."""
    if not bench.zero_angle or not source.layout.has(ANGLE_COLUMN):
        return numbers
    return {**numbers, ANGLE_COLUMN: numbers[ANGLE_COLUMN] - bench.zero_angle}


def _unsettled(entry: RunEntry, where: str, levels: "Sequence[reduce.UnsettledLevel]") -> Finding:
    count, named = len(levels), [_level_text(level) for level in levels[:_MOST_LEVELS]]
    rest = f" and {count - len(named)} more" if count > len(named) else ""
    plural = "s" if count > 1 else ""
    what = f"{count} level{plural} of the stimulus left out, not steady: {'; '.join(named)}{rest}"
    remedy = "record each level longer than the table takes to settle"
    return Finding("not_settled", "warning", entry.name, what, where, "steady outputs at each level", remedy)


def _level_text(level: "reduce.UnsettledLevel") -> str:
    at = f"raw row {level.row + 1}" + (f" ({level.time:g} s)" if level.time is not None else "")
    return f"{level.channel} from {at}" if level.channel else f"shorter than settling_s from {at}"


def _unsteady(entry: RunEntry, where: str, rows: tuple[int, ...]) -> Finding:
    what = f"the stimulus varies within {len(rows)} labelled segments"
    allowed = "one rate, one angle or rest per segment"
    remedy = "leave the label of transients empty"
    return Finding("segment_not_constant", "warning", entry.name, what, f"{where}, column 'segment'", allowed, remedy)
