"""Read a campaign folder as a `Campaign`, without saturated means, and a model file as a `ModelFile`.

All files are read before an error is raised: `inspect_campaign` returns every issue and finding together with the
campaign, if valid; `load_campaign` raises all issues at once.  The raw log behind a run that was read can be streamed
again for an evaluation of single samples.

Means at the limit of their channel are left out, because they only say that the input was beyond.  A raw log shows its
limit by samples that stay there.  A table of means shows it by equal outputs at different inputs, or by a mean without
scatter that falls short of the line through the others, each at the extreme of the channel.  Means of samples near a
limit are biased as well.
"""

import hashlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imubayes.campaign import equipment as stated
from imubayes.campaign.file_schemas import CampaignFile, Draft, ModelFile, RunEntry, draft_of
from imubayes.campaign.physical_checks import LEAST_SPREAD
from imubayes.campaign.reduction import clipping_note
from imubayes.campaign.repeated_data import check_repeats
from imubayes.campaign.run_reader import Equipment, Loaded, judge_rows, load_run
from imubayes.campaign.run_tables import TableSource, lay_out, read_header
from imubayes.campaign.run_times import check_times
from imubayes.campaign.setup_gate.judgement import SETUP_FINDINGS, setup_findings
from imubayes.campaign.setup_gate.remedies import Places
from imubayes.campaign.stream_checks import LIKE_UNITS, SYMPTOMS, UNIT_FINDINGS, Finding
from imubayes.campaign.toml_documents import Ledger, read_document
from imubayes.foundations.campaign_data import Campaign, Channel, Run, Site
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error, refuse
from imubayes.foundations.units import STANDARD_GRAVITY
from imubayes.procedures import PROCEDURES, procedure_named

LEAST_ROWS = 5  # of a channel, to tell a limit
EQUAL_OUTPUT = 1e-9  # of the range of the outputs
OTHER_INPUT = 0.02  # of the range of the inputs
SHORT_OF_LINE = 0.01  # of the range of the outputs; a coarse output without scatter at rest lies on the line
NEAR_LIMIT_SD = 4.0  # a mean so near to the limit holds clipped samples


def without_saturated_rows(loaded: Sequence[Loaded], files: Sequence[str], equipment: Equipment) -> None:
    """Empty the cells of clipped means in every run, and note what was left out as a finding of the run.

    Parameters
    ----------
    loaded : the runs, changed in place; free tumbles and runs that could not be loaded are left as they are.
    files : the table of each.
    """
    runs = [each.run for each in loaded if each.run is not None and each.run.tumble is None]
    if not runs:
        return
    for place, channel in enumerate(equipment.channels):
        limits = tuple(_limits(runs, place, channel, equipment))
        for each, file in zip(loaded, files, strict=True):
            if limits and each.run is not None and each.run.tumble is None:
                _leave_out(each, each.run, place, channel, limits, file)


def _limits(runs: Sequence[Run], place: int, channel: Channel, equipment: Equipment) -> Iterator[float]:
    """Yield the limits that the means of a channel show."""
    observed = np.concatenate([run.observed[:, place] for run in runs])
    stimulus = np.concatenate([_stimulus(run, channel, equipment) for run in runs])
    known = np.isfinite(observed) & np.isfinite(stimulus)
    if (
        known.sum() < LEAST_ROWS
        or np.ptp(observed[known]) == 0
        or np.ptp(stimulus[known]) <= LEAST_SPREAD[channel.kind]
    ):
        return
    steady = np.concatenate([(run.sample_sd[:, place] == 0) & (run.samples > 1) for run in runs])
    steady = steady & (_scatter(runs, place) > 0)
    for extreme, inward in ((float(observed[known].min()), 1.0), (float(observed[known].max()), -1.0)):
        there = known & (np.abs(observed - extreme) <= EQUAL_OUTPUT * np.ptp(observed[known]))
        others = known & ~there
        apart = np.ptp(stimulus[there]) > OTHER_INPUT * np.ptp(stimulus[known])
        short = inward * _beyond_line(stimulus, observed, others) > SHORT_OF_LINE * np.ptp(observed[known])
        if apart or (there & steady & short).any():
            yield extreme


def _beyond_line(stimulus: np.ndarray, observed: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Return by how much outputs exceed the straight line through the other rows, (R,); 0 where these give none."""
    if others.sum() < LEAST_ROWS - 1 or np.ptp(stimulus[others]) == 0:
        return np.zeros(len(observed))
    slope, intercept = np.polyfit(stimulus[others], observed[others], 1)
    return observed - (slope * stimulus + intercept)


def _stimulus(run: Run, channel: Channel, equipment: Equipment) -> np.ndarray:
    """Return the nominal input of a channel in each row, (R,); NaN where the procedure states none."""
    table, mounting = equipment.tables.get(run.table or ""), equipment.mountings.get(run.mounting or "")
    try:
        stimulus = PROCEDURES[run.procedure].nominal_input(run, channel, equipment.site, table, mounting)
    except InputError:
        stimulus = None  # what the equipment lacks is told where the rows are judged
    return np.full(run.rows, np.nan) if stimulus is None else stimulus


def _scatter(runs: Sequence[Run], place: int) -> float:
    """Return the median standard deviation of the samples of a channel; 0 where none is recorded."""
    recorded = np.concatenate([run.sample_sd[:, place] for run in runs])
    return float(np.median(recorded[np.isfinite(recorded)])) if np.isfinite(recorded).any() else 0.0


def _leave_out(loaded: Loaded, run: Run, place: int, channel: Channel, limits: Sequence[float], file: str) -> None:
    observed = run.observed[:, place]
    margin = max(NEAR_LIMIT_SD * _scatter([run], place), EQUAL_OUTPUT * float(np.abs(limits).max()))
    clipped = np.any([np.abs(observed - limit) <= margin for limit in limits], axis=0)
    if not clipped.any():
        return
    what = clipping_note(channel.name, limits, int(clipped.sum()), run.rows, "means")
    finding = Finding(
        "saturated_channel", "warning", run.name, f"channel {what}", f"{file}, column '{channel.name}'",
        "outputs within the range of the converter", "test within the range, or leave the cells empty",
    )  # fmt: skip
    empty = clipped[:, None] & (np.arange(run.observed.shape[1]) == place)
    loaded.findings.append(finding)
    observed, sample_sd = (np.where(empty, np.nan, values) for values in (run.observed, run.sample_sd))
    loaded.run = replace(run, observed=observed, sample_sd=sample_sd)


CAMPAIGN_FILE = "campaign.toml"
TABLE_FILES = ("*.csv", "*.parquet", "*/*.csv", "*/*.parquet")


@dataclass(frozen=True)
class Inspection:
    """Result of reading a campaign.

    Attributes
    ----------
    campaign : the campaign; None if there are issues.
    issues : faults of the files, and findings of severity error.
    findings : findings in the data, errors and warnings.
    """

    campaign: Campaign | None
    issues: tuple[Issue, ...]
    findings: tuple[Finding, ...]


def load_campaign(path: str | Path, *, judge_setup: bool = True) -> Campaign:
    """Read a campaign folder.

    Parameters
    ----------
    path : the folder, or its `campaign.toml`.
    judge_setup : whether the outputs are held against the set-up; not needed where that was done before a fit.

    Raises
    ------
    InputError
        with every issue of the campaign.

    Examples
    --------
    >>> import imubayes
    >>> campaign = imubayes.load_campaign("data/accel-channel")
    >>> [(run.name, run.procedure) for run in campaign.runs]
    [('ramp-1g', 'thermal_ramp'), ('ramp-trihedral', 'thermal_ramp'), ('inject-12g', 'current_injection')]
    """
    inspection = inspect_campaign(path, judge_setup=judge_setup)
    if inspection.campaign is None:
        raise InputError(inspection.issues)
    return inspection.campaign


def check_campaign(path: str | Path) -> tuple[Finding, ...]:
    """Return the findings in the data of a campaign, errors and warnings alike; it raises for no fault of the data.

    Parameters
    ----------
    path : the folder, or its `campaign.toml`.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.check_campaign("data/accel-channel")
    ()
    """
    return inspect_campaign(path).findings


def inspect_campaign(path: str | Path, *, judge_setup: bool = True) -> Inspection:
    """Read a campaign folder and return the campaign with all issues and findings; never raises for bad input."""
    file = Path(path)
    file = file if file.suffix == ".toml" else file / CAMPAIGN_FILE
    if not file.exists():
        return Inspection(None, (_no_campaign(file),), ())
    try:
        document = read_document(file, CampaignFile)
    except InputError as error:
        return Inspection(None, error.issues, ())
    draft, ledger = draft_of(document.content), document.ledger
    equipment = _equipment(draft, ledger)
    stated.refuse_reserved_names(draft.channels, draft.names["channel"], ledger)
    _check_accepted(document.entry, ledger)
    _check_runs(draft, ledger)
    judge = None if ledger.issues else equipment
    loaded = [_load(file.parent / run.file, run, draft.names["channel"], judge) for run in draft.runs.values()]
    _judge_rows(loaded, list(draft.runs.values()), file.parent, judge)
    findings = tuple(finding for result in loaded for finding in result.findings)
    issues = [*ledger.issues, *(issue for result in loaded for issue in result.issues)]
    if not judge_setup or not _await_the_gate(loaded, findings):
        issues += _problems(findings)
    if issues or document.entry is None:
        return Inspection(None, tuple(issues), findings)
    campaign = _campaign(document.entry, equipment, loaded, findings, file)
    if not judge_setup:
        return Inspection(campaign, (), findings)
    return _with_setup(campaign, document.entry, findings, Places(document.entry, ledger))


def _judge_rows(
    loaded: Sequence[Loaded], entries: Sequence[RunEntry], folder: Path, equipment: Equipment | None
) -> None:
    """Leave out what is clipped, which all runs together tell, and check what each run then holds."""
    if equipment is None:
        return
    files = [str(folder / entry.file) for entry in entries]
    without_saturated_rows(loaded, files, equipment)
    read = [(each, file) for each, file in zip(loaded, files, strict=True) if each.run is not None]
    runs, named = [each.run for each, _ in read if each.run is not None], [file for _, file in read]
    between = [*check_repeats(runs, named, equipment.channels), *check_times(runs, named)]
    for each, entry, file in zip(loaded, entries, files, strict=True):
        judge_rows(each, entry, equipment, file)
    _add_to_runs(loaded, entries, between)


def _add_to_runs(loaded: Sequence[Loaded], entries: Sequence[RunEntry], between: Sequence[Finding]) -> None:
    """Add what runs tell of each other to the first that it concerns; a wrong unit of time makes turns look short."""
    for finding in between:
        place = next((k for k, entry in enumerate(entries) if entry.name == finding.run), 0)
        loaded[place].findings.append(finding)
    if any(finding.name == "time_unit" for finding in between):
        for each in loaded:
            each.findings = [finding for finding in each.findings if finding.name != "partial_turn"]


def _problems(findings: Sequence[Finding]) -> tuple[Issue, ...]:
    return tuple(finding.problem() for finding in findings if finding.severity == "error")


def _await_the_gate(loaded: Sequence[Loaded], findings: Sequence[Finding]) -> bool:
    """Whether all errors are wrong units in single runs, which may be what another mistake looks like there."""
    units = all(finding.name in UNIT_FINDINGS for finding in findings if finding.severity == "error")
    return units and all(result.run is not None for result in loaded)


def _with_setup(campaign: Campaign, entry: CampaignFile, findings: Sequence[Finding], places: Places) -> Inspection:
    """Return the inspection of a valid campaign with what its outputs say against its set-up."""
    found = setup_findings(campaign, places, tuple(entry.accepted))
    # One wrong run makes others disagree with it; what is wrong has been said of the run itself.
    noticed = any(finding.name in SYMPTOMS for finding in findings)
    found = [finding for finding in found if not (noticed and finding.name == "setup_disagrees")]
    units, wrong = _problems(findings), _problems(found)
    if units and not any(finding.name in LIKE_UNITS and finding.severity == "error" for finding in found):
        return Inspection(None, units, tuple(findings))
    if wrong:
        # The mistake explains what the checks of single runs noticed of it.
        said = [each for each in findings if each.name not in SYMPTOMS and each.severity != "error"]
        return Inspection(None, wrong, (*said, *found))
    return Inspection(replace(campaign, notes=(*campaign.notes, *map(str, found))), (), (*findings, *found))


def read_model_file(path: str | Path) -> ModelFile:
    """Read a model file; effect names are validated later, by the effect registry.

    Raises
    ------
    InputError
        with every violation of the schema.
    """
    document = read_document(Path(path), ModelFile)
    folder = Path(path).parent
    for index, name in enumerate(document.entry.files if document.entry else ()):
        if not (folder / name).is_file():
            near = closest_first(name, [file.name for file in folder.glob("*.py")])
            allowed = near or "a Python file beside the model file"
            document.ledger.add(f"the file '{name}' does not exist", ("files", index), allowed, "correct the path")
    priors = document.entry.noise_priors if document.entry else None
    if priors is not None and not (folder / priors).is_file():
        allowed = "noise-priors.toml, as `imubayes noise CAMPAIGN --out FOLDER` writes it"
        document.ledger.add(f"the file '{priors}' does not exist", ("noise_priors",), allowed, "correct the path")
    document.ledger.stop_if_any()
    assert document.entry is not None
    return document.entry


def _no_campaign(file: Path) -> Issue:
    folder = file.parent
    near = [*folder.glob(f"*/{CAMPAIGN_FILE}"), *folder.parent.glob(f"*/{CAMPAIGN_FILE}")]
    names = [str(path.parent) for path in sorted(near)]
    return Issue(
        f"there is no file '{file.name}' in {folder}" if folder.is_dir() else f"there is no folder '{folder}'",
        str(file),
        closest_first(str(folder), names) or f"a folder with {CAMPAIGN_FILE}",
        "give the path of a campaign folder",
    )


def _equipment(draft: Draft, ledger: Ledger) -> Equipment:
    site = Site(0.0, 0.0, STANDARD_GRAVITY) if draft.site is None else stated.build_site(draft.site)
    return Equipment(
        site,
        stated.build_channels(draft.channels, site.gravity, ledger),
        stated.build_tables(draft.tables, ledger),
        stated.build_mountings(draft.mountings, ledger),
        stated.build_benches(draft.tables),
    )


def _campaign(
    entry: CampaignFile, equipment: Equipment, loaded: Sequence[Loaded], findings: Sequence[Finding], file: Path
) -> Campaign:
    runs = tuple(result.run for result in loaded if result.run is not None)
    channels, runs = stated.with_angles(equipment.channels, runs, equipment.tables)
    channels, noise_notes = _fill_noise(channels, runs)
    return Campaign(
        entry.name,
        equipment.site,
        channels,
        equipment.tables,
        equipment.mountings,
        runs,
        entry.unit.serial,
        source_digest([file, *(file.parent / run.file for run in entry.run)]),
        (*entry.notes, *noise_notes, *(str(finding) for finding in findings)),
        str(file.parent),
        entry.unit.grade,
        None if (percent := entry.evaluation.delta_k_threshold_percent) is None else percent / 100,
    )


def _load(file: Path, entry: RunEntry, names: Sequence[str], equipment: Equipment | None) -> Loaded:
    # A missing file has been reported with the line that names it.
    return load_run(file, entry, names, equipment) if file.is_file() else Loaded()


def _check_runs(draft: Draft, ledger: Ledger) -> None:
    stated.refuse_repeats({index: run.name for index, run in draft.runs.items()}, "run", ledger)
    for index, run in draft.runs.items():
        if run.procedure not in PROCEDURES:
            ledger.add(
                f"procedure '{run.procedure}' of run '{run.name}' is not known",
                ("run", index, "procedure"),
                closest_first(run.procedure, PROCEDURES, most=len(PROCEDURES)),
                "use one of the allowed procedures",
            )
        stated.check_references(run, index, draft.names, ledger)
        _check_file(run, index, ledger)
    _check_gyros(draft, ledger)
    injected = [index for index, run in draft.runs.items() if procedure_named(run.procedure).injected]
    # An invalid channel entry may be the one with the key.
    complete = len(draft.channels) == len(draft.names["channel"])
    if injected and complete:
        stated.require_current_scale(draft.channels.values(), injected[0], ledger)


def _check_accepted(entry: CampaignFile | None, ledger: Ledger) -> None:
    for index, name in enumerate(entry.accepted if entry is not None else ()):
        if name not in SETUP_FINDINGS:
            ledger.add(
                f"'{name}' is no finding about the set-up", ("accepted", index),
                closest_first(name, SETUP_FINDINGS), "correct or remove the name",
            )  # fmt: skip


def _check_gyros(draft: Draft, ledger: Ledger) -> None:
    """Add an issue for every run that requires a gyro, in a unit without gyros."""
    if any(channel.kind == "gyro" for channel in draft.channels.values()):
        return
    for index, run in draft.runs.items():
        if procedure_named(run.procedure).needs_gyro:
            ledger.add(
                f"run '{run.name}' of procedure '{run.procedure}' has no gyro",
                ("run", index, "procedure"),
                'a [[channel]] of kind = "gyro"',
                "add the gyro, or correct 'procedure'",
            )


def _check_file(run: RunEntry, index: int, ledger: Ledger) -> None:
    file = ledger.file.parent / run.file
    if file.is_file():
        return
    root = ledger.file.parent
    near = sorted(str(p.relative_to(root)) for pattern in TABLE_FILES for p in root.glob(pattern))
    what = "is a folder" if file.is_dir() else "does not exist"
    ledger.add(
        f"the table '{run.file}' of run '{run.name}' {what}",
        ("run", index, "file"),
        closest_first(run.file, near) or "a CSV or Parquet file inside the campaign folder",
        "correct the path (relative to campaign.toml), or supply the file",
    )


def _fill_noise(channels: Sequence[Channel], runs: Sequence[Run]) -> tuple[tuple[Channel, ...], list[str]]:
    """Set unstated channel noise to the pooled standard deviation of one sample, from rows at rest if there are any."""
    filled, notes = [], []
    for index, channel in enumerate(channels):
        pooled = math.nan if channel.noise is not None else _pooled(runs, index)
        if math.isfinite(pooled) and pooled > 0:
            notes.append(
                f"noise of channel '{channel.name}': {pooled:.4g} {channel.output_unit}, from the scatter within means"
            )
            channel = replace(channel, noise=pooled)
        filled.append(channel)
    return tuple(filled), notes


def _pooled(runs: Sequence[Run], index: int) -> float:
    sd = np.concatenate([run.sample_sd[:, index] for run in runs])
    freedom = np.concatenate([run.samples for run in runs]) - 1
    still = np.concatenate([run.covariates["table_rate"] for run in runs]) == 0
    good = np.isfinite(sd) & (freedom > 0)
    good = good & still if np.any(good & still) else good
    return math.sqrt(float(np.average(sd[good] ** 2, weights=freedom[good]))) if good.any() else math.nan


def source_digest(files: Sequence[Path]) -> str:
    """Return the SHA-256 of the files of a campaign: the campaign file, then the table of every run."""
    digest = hashlib.sha256()
    for file in files:
        with file.open("rb") as stream:
            digest.update(hashlib.file_digest(stream, "sha256").digest())
    return digest.hexdigest()


def raw_log(campaign: Campaign, run: Run) -> TableSource:
    """Return the table of a run as a stream.

    Raises
    ------
    InputError
        where the campaign was not read from a folder, or its files are gone.
    """
    if not campaign.folder:
        raise input_error(
            "the campaign has no files", f"campaign '{campaign.name}'", "a campaign folder", "give the folder"
        )
    file = Path(campaign.folder) / CAMPAIGN_FILE
    document = read_document(file, CampaignFile)
    document.ledger.stop_if_any()
    assert document.entry is not None
    entry = next(entry for entry in document.entry.run if entry.name == run.name)
    table = file.parent / entry.file
    names = [channel.name for channel in campaign.channels]
    layout, issues = lay_out(read_header(table), names, entry.ignore, PROCEDURES[run.procedure], str(table))
    refuse(issues)
    return TableSource(table, layout)
