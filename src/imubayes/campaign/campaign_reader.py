"""Read a campaign folder as a `Campaign`, and a model file as a `ModelFile`.

All files are read before an error is raised: `inspect_campaign` returns every issue and finding together with the
campaign, if valid; `load_campaign` raises all issues at once.  The raw log behind a run that was read can be streamed
again for an evaluation of single samples.
"""

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np

from imubayes.campaign import equipment as stated
from imubayes.campaign.column_layout import lay_out
from imubayes.campaign.file_schemas import CampaignFile, Draft, ModelFile, RunEntry, draft_of
from imubayes.campaign.instruments import (
    build_instruments,
    build_thermometers,
    refuse_two_readings,
)
from imubayes.campaign.physical_checks import check_gravity, check_rows
from imubayes.campaign.repeated_data import check_repeats
from imubayes.campaign.run_reader import Equipment, Loaded, judge_rows, load_run
from imubayes.campaign.run_tables import TableFile, TableSource, read_header
from imubayes.campaign.run_times import check_times
from imubayes.campaign.sample_checks import check_samples
from imubayes.campaign.saturated_rows import without_saturated_rows
from imubayes.campaign.setup_gate.judgement import SETUP_FINDINGS, setup_findings
from imubayes.campaign.setup_gate.places import Places
from imubayes.campaign.stream_checks import LIKE_UNITS, SYMPTOMS, UNIT_FINDINGS, Finding
from imubayes.campaign.toml_documents import Document, Ledger, read_document
from imubayes.foundations.campaign_data import Campaign, Channel, Run, Site
from imubayes.foundations.errors import InputError, Issue, closest_first, input_error, refuse
from imubayes.foundations.units import STANDARD_GRAVITY
from imubayes.procedures import PROCEDURES, procedure_named

CAMPAIGN_FILE = "campaign.toml"
"""The file of a campaign folder that states the measurements."""
TABLE_FILES = ("*.csv", "*.parquet", "*/*.csv", "*/*.parquet")


@runtime_checkable
class Tables(Protocol):
    """The tables of the runs of a campaign: files of its folder, or what was handed over.

    `folder` is empty if there is none.
    """

    @property
    def folder(self) -> str: ...

    def of(self, run: RunEntry) -> TableFile | None:
        """Return the table of a run; None if there is none."""
        ...

    def place(self, run: RunEntry) -> str:
        """Return where the table of a run is, for messages."""
        ...

    def check(self, run: RunEntry, index: int, ledger: Ledger) -> None:
        """Add an issue if a run, the index-th, has no table."""
        ...

    def digest(self, entry: CampaignFile) -> str:
        """Return the SHA-256 of the campaign and its tables."""
        ...


@dataclass(frozen=True)
class _TablesOfFolder:
    file: Path

    @property
    def folder(self) -> str:
        return str(self.file.parent)

    def _path(self, run: RunEntry) -> Path:
        return self.file.parent / run.file

    def of(self, run: RunEntry) -> TableFile | None:
        return path if (path := self._path(run)).is_file() else None

    def place(self, run: RunEntry) -> str:
        return str(self._path(run))

    def digest(self, entry: CampaignFile) -> str:
        return source_digest([self.file, *map(self._path, entry.run)])

    def check(self, run: RunEntry, index: int, ledger: Ledger) -> None:
        path, root = self._path(run), self.file.parent
        if path.is_file():
            return
        near = sorted(str(p.relative_to(root)) for pattern in TABLE_FILES for p in root.glob(pattern))
        what = "is a folder" if path.is_dir() else "does not exist"
        ledger.add(
            f"the table '{run.file}' of run '{run.name}' {what}",
            ("run", index, "file"),
            closest_first(run.file, near) or "a CSV or Parquet file inside the campaign folder",
            "correct the path (relative to campaign.toml), or supply the file",
        )


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
    judge_setup : whether the outputs are compared with the set-up; not needed if that was done before a fit.

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


def check_campaign(campaign: Campaign | str | Path) -> tuple[Finding, ...]:
    """Return the findings in the data of a campaign, errors and warnings alike; it raises for no fault of the data.

    Parameters
    ----------
    campaign : a campaign in memory, a folder, or its `campaign.toml`.  The files of a folder are read again.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.check_campaign("data/accel-channel")
    ()
    """
    if isinstance(campaign, Campaign) and not campaign.folder:
        return _findings_in_memory(campaign)
    return inspect_campaign(campaign.folder if isinstance(campaign, Campaign) else campaign).findings


def _findings_in_memory(campaign: Campaign) -> tuple[Finding, ...]:
    """Return the findings in the rows of runs, between runs, and about the set-up."""
    tables = {run.name: f"run '{run.name}'" for run in campaign.runs}
    found = [
        *check_repeats(campaign.runs, [*tables.values()], campaign.channels),
        *check_times(campaign.runs, [*tables.values()]),
        *check_samples(campaign.runs, [*tables.values()], campaign.channels),
    ]
    for run in campaign.runs:
        table, mounting = campaign.tables.get(run.table or ""), campaign.mountings.get(run.mounting or "")
        found += check_rows(run, campaign.channels, campaign.site, table, mounting, tables[run.name])
    places = Places(campaign, Ledger(Path(f"campaign '{campaign.name}'")), tables, {run: run for run in tables})
    site = check_gravity(campaign.site, places.ledger.where("site", "gravity_m_s2"))
    return (*site, *found, *setup_findings(campaign, places, ()))


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
    return inspect_document(document, _TablesOfFolder(file), judge_setup=judge_setup)


def inspect_document(document: Document[CampaignFile], tables: Tables, *, judge_setup: bool = True) -> Inspection:
    """Return the campaign of a document and its tables, with all issues and findings.

    Parameters
    ----------
    tables : of the runs.
    judge_setup : as for `load_campaign`.
    """
    draft, ledger = draft_of(document.content), document.ledger
    equipment = _equipment(draft, ledger)
    stated.refuse_reserved_names(draft.channels, draft.names["channel"], ledger)
    _check_accepted(document.entry, ledger)
    _check_runs(draft, tables, ledger)
    judge = None if ledger.issues else equipment
    loaded = [_load(tables.of(run), run, draft.names["channel"], judge) for run in draft.runs.values()]
    _judge_rows(loaded, list(draft.runs.values()), tables, judge)
    site = check_gravity(judge.site, ledger.where("site", "gravity_m_s2")) if judge is not None else []
    findings = (*site, *(finding for result in loaded for finding in result.findings))
    issues = [*ledger.issues, *(issue for result in loaded for issue in result.issues)]
    if not judge_setup or not _await_the_gate(loaded, findings):
        issues += _problems(findings)
    if issues or document.entry is None:
        return Inspection(None, tuple(issues), findings)
    campaign = _campaign(document.entry, equipment, loaded, findings, tables)
    if not judge_setup:
        return Inspection(campaign, (), findings)
    where = {run.name: tables.place(run) for run in document.entry.run}
    places = Places(campaign, ledger, where, {run.name: run.file for run in document.entry.run})
    return _with_setup(campaign, document.entry, findings, places)


def _judge_rows(
    loaded: Sequence[Loaded], entries: Sequence[RunEntry], tables: Tables, equipment: Equipment | None
) -> None:
    """Leave out what is clipped, which all runs together determine, and check what each run then holds."""
    if equipment is None:
        return
    files = [tables.place(entry) for entry in entries]
    without_saturated_rows(loaded, files, equipment)
    read = [(each, file) for each, file in zip(loaded, files, strict=True) if each.run is not None]
    runs, named = [each.run for each, _ in read if each.run is not None], [file for _, file in read]
    between = [
        *check_repeats(runs, named, equipment.channels),
        *check_times(runs, named),
        *check_samples(runs, named, equipment.channels),
    ]
    for each, entry, file in zip(loaded, entries, files, strict=True):
        judge_rows(each, entry, equipment, file)
    _add_to_runs(loaded, entries, between)


def _add_to_runs(loaded: Sequence[Loaded], entries: Sequence[RunEntry], between: Sequence[Finding]) -> None:
    """Add findings from comparing runs to the first that it concerns; a wrong unit of time makes turns look short."""
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


def _explains_units(finding: Finding) -> bool:
    """Whether a finding looks like wrong units in single runs; of a channel in all runs one mistake is reported."""
    like = finding.name in LIKE_UNITS or (finding.name in ("channel_unit", "rate_unit") and not finding.run)
    return like and finding.severity == "error"


def _with_values(findings: Sequence[Finding], found: Sequence[Finding]) -> tuple[tuple[Finding, ...], list[Finding]]:
    """Return findings of impossible rates with the values that the outputs show, and what else the outputs show."""
    rows = {(each.run, each.record.quantity): each for each in found if each.record is not None and each.record.row}
    told, used = list[Finding](), list[Finding]()
    for each in findings:
        column = each.where.rsplit("'", 2)[-2] if each.name == "rate_impossible" else ""
        if row := rows.get((each.run, column)):
            each, used = replace(each, what=f"{each.what}; {row.what}", remedy=row.remedy), [*used, row]
        told.append(each)
    return tuple(told), [each for each in found if all(each is not other for other in used)]


def _with_setup(campaign: Campaign, entry: CampaignFile, findings: Sequence[Finding], places: Places) -> Inspection:
    """Return the inspection of a valid campaign with what its outputs say against its set-up."""
    found = setup_findings(campaign, places, tuple(entry.accepted))
    findings, found = _with_values(findings, found)
    # One wrong run makes others disagree with it; what is wrong has been said of the run itself.
    noticed = any(finding.name in SYMPTOMS for finding in findings)
    found = [finding for finding in found if not (noticed and finding.name == "setup_disagrees")]
    # One block for one mistake: what a column alone shows is said with the evidence of the outputs, if they show it.
    told = {(finding.name, finding.run) for finding in found}
    findings = [
        finding for finding in findings if finding.severity == "error" or (finding.name, finding.run) not in told
    ]
    units, wrong = _problems(findings), _problems(found)
    if units and not any(map(_explains_units, found)):
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
        build_thermometers(draft.thermometers, ledger),
    )


def _campaign(
    entry: CampaignFile, equipment: Equipment, loaded: Sequence[Loaded], findings: Sequence[Finding], tables: Tables
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
        tables.digest(entry),
        (*entry.notes, *noise_notes, *(str(finding) for finding in findings)),
        tables.folder,
        entry.unit.grade,
        None if (percent := entry.evaluation.delta_k_threshold_percent) is None else percent / 100,
        labels=entry.unit.labels,
        thermometers=equipment.thermometers,
        instruments=build_instruments(entry.instruments),
    )


def _load(file: TableFile | None, entry: RunEntry, names: Sequence[str], equipment: Equipment | None) -> Loaded:
    # A missing table has been reported with the line that names it.
    return Loaded() if file is None else load_run(file, entry, names, equipment)


def _check_runs(draft: Draft, tables: Tables, ledger: Ledger) -> None:
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
        tables.check(run, index, ledger)
    refuse_two_readings(draft.runs, ledger)
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
                f"'{name}' is not a finding about the set-up", ("accepted", index),
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
        if the campaign was not read from a folder, or its files are gone.
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
