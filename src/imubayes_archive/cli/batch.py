"""Commands `imubayes batch` and `imubayes archive`: a campaign archive, its batch fit, and questions asked of a batch.

`imubayes batch` fits every campaign of an archive with one model.  Its subcommands
`population|prior|diagnose|compare|drift` ask questions of all units of a batch.  `imubayes archive` keeps campaign
folders as one Parquet dataset.
"""

from pathlib import Path
from typing import TYPE_CHECKING, Literal

import cyclopts

from imubayes.cli.session import Flag, Json, Repeated, Trust, progress, show, start_jax, trusting

if TYPE_CHECKING:
    import polars as pl

    from imubayes_archive.population.hierarchical_fit import HierarchicalFit


batch = cyclopts.App(
    name="batch",
    help="Fit every campaign of an archive with one model, and compare the units.\n\n"
    "Example: imubayes batch data/unit-archive --model accel-channel --out results/units",
)


@batch.default
def fit_all(
    archive: Path,
    *,
    model: Path,
    out: Path,
    sample: Literal["all", "flagged", "none"] = "none",
    diagnose: Flag = False,
    seed: int = 0,
    retry: Flag = False,
    workers: int | None = None,
    scheduler: str | None = None,
    as_json: Json = False,
) -> int:
    """Fit every campaign of an archive, or of a folder of campaigns, that has no result yet.

    An interrupted batch continues when it is run again.  A campaign that cannot be fitted is listed
    with its reason and stops nothing.

    Example: imubayes batch archive --model models/trihedral-imu.toml --out results/archive

    Parameters
    ----------
    archive
        Archive, or folder with campaign folders.
    model
        Model file, or the name of a shipped model.
    out
        Results folder.
    sample
        Units whose posterior is sampled; the others have the Laplace approximation. The units `flagged` are those
        whose importance weights (Pareto k, skewness) put that approximation in doubt.
    diagnose
        Diagnose each fit; the verdict is in the table.
    seed
        Seed of the sampler.
    retry
        Try campaigns without estimates again, not only those whose files have changed.
    workers
        Number of local processes. Without it and without a scheduler, this process fits all units.
    scheduler
        Fit on the workers of this Dask scheduler, such as tcp://node:8786.
    as_json
        Print one JSON object on standard output.
    """
    start_jax()
    from imubayes_archive.api.archives import batch
    from imubayes_archive.display.batch_report import batch_json, batch_report

    with progress() as tell:
        fits = batch(
            archive, model, out, sample=sample, diagnose=diagnose, seed=seed, retry=retry, workers=workers,
            scheduler=scheduler, progress=tell,
        )  # fmt: skip
        tell("comparing the units")
        doubts, units, state = fits.in_doubt(), fits.units, fits.state
    assert state is not None
    show(lambda: batch_json(state, units, fits.model, doubts), lambda: batch_report(state, units, out, doubts), as_json)
    return 1 if (units["status"] != "fitted").any() else 0


def _of_one_model(results: Path, model_hash: str | None) -> tuple[Path, str | None]:
    """Return results folder and hash; the folder may also be that of one model, `RESULTS/model-<hash>`."""
    if results.name.startswith("model-") and model_hash is None:
        return results.parent, results.name.removeprefix("model-")
    return results, model_hash


def _tables(results: Path, model_hash: str | None) -> tuple["pl.DataFrame", "pl.DataFrame"]:
    """Return the tables of parameters and of units."""
    from imubayes_archive.unit_fits.posterior_table import read_parameters, read_units

    results, model_hash = _of_one_model(results, model_hash)
    return read_parameters(results, model_hash), read_units(results, model_hash)


def _write(table: "pl.DataFrame", file: Path | None) -> None:
    from imubayes.foundations.files import replacing

    if file is not None:
        with replacing(file) as scratch:
            table.write_parquet(scratch)


@batch.command
def population(
    results: Path,
    *,
    alone: Flag = False,
    parameter: Repeated = None,
    out: Path | None = None,
    picture: Path | None = None,
    model_hash: str | None = None,
    as_json: Json = False,
    trust: Trust = False,
) -> None:
    """Show groups of units, mean and spread of every parameter, and the units that differ from the others.

    Each unit is fitted again with the population of the others as its prior; that is kept in the results folder.

    Example: imubayes batch population results/batch --out units.parquet

    Parameters
    ----------
    results
        Results folder of a batch.
    alone
        Use the fit of each unit alone; no campaign is read.
    parameter
        Parameters to draw; by default those that deviate most.
    out
        Parquet file to write: each unit with the population as its prior.
    picture
        PNG file to write: the units of each parameter.
    model_hash
        Model, if the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    from imubayes_archive.display.population_report import population_report

    fit = None if alone else _hierarchical(results, model_hash, trust)
    if fit is None:
        from imubayes_archive.population.parameter_population import populations

        found, units = populations(*_tables(results, model_hash))
    else:
        found, units = fit.populations, fit.units
    _write(units, out)
    if picture is not None:
        from imubayes_archive.display.figures.population import population_picture

        population_picture(found, units, parameter or ()).save(picture)
    show(lambda: found, lambda: population_report(found, fit), as_json)


def _hierarchical(results: Path, model_hash: str | None, trust: bool) -> "HierarchicalFit":
    """Return the hierarchical fit of a batch, made if it is not kept."""
    start_jax()
    from imubayes_archive.population.hierarchical_fit import hierarchical_fit
    from imubayes_archive.unit_fits.posterior_table import kept_model

    with progress() as tell:
        results, model_hash = _of_one_model(results, model_hash)
        trusting(kept_model(results, model_hash), trust)
        tell("compiling for the first campaigns")
        return hierarchical_fit(results, model_hash, progress=tell)


@batch.command
def prior(
    results: Path,
    *,
    out: Path,
    name: str = "",
    model_hash: str | None = None,
    as_json: Json = False,
    trust: Trust = False,
) -> None:
    """Write a model for the next unit, whose priors are the population of the units so far.

    Example: imubayes batch prior results/batch --out models/next-unit.toml

    Parameters
    ----------
    results
        Results folder of a batch.
    out
        Model file to write.
    name
        Name of the new model.
    model_hash
        Model, if the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    from dataclasses import asdict

    from imubayes.foundations.files import refuse_existing
    from imubayes.model.model_file import read_carried_model
    from imubayes.results.result_folder import write_model
    from imubayes_archive.display.population_report import prior_report
    from imubayes_archive.population.population_priors import next_unit_model
    from imubayes_archive.unit_fits.posterior_table import kept_model

    found = _hierarchical(results, model_hash, trust).populations
    kept = kept_model(_of_one_model(results, model_hash)[0], found.model)
    spec, replaced = next_unit_model(read_carried_model(kept), found, name)
    refuse_existing(out)
    write_model(spec, out)
    record = {"format": 1, "model": str(out), "priors": [asdict(each) for each in replaced]}
    show(lambda: record, lambda: prior_report(replaced, out), as_json)


@batch.command
def diagnose(
    results: Path,
    *,
    picture: Path | None = None,
    model_hash: str | None = None,
    as_json: Json = False,
    trust: Trust = False,
) -> None:
    """Look for effects that the model lacks, with the evidence of all units added up.

    The scores of every unit are computed once and kept in the results folder.

    Example: imubayes batch diagnose results/batch

    Parameters
    ----------
    results
        Results folder of a batch.
    picture
        PNG file to write: the evidence of every unit.
    model_hash
        Model, if the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    start_jax()
    from imubayes_archive.display.batch_report import discovery_report
    from imubayes_archive.unit_fits.pooled_discovery import pooled_discovery
    from imubayes_archive.unit_fits.posterior_table import kept_model, read_units
    from imubayes_archive.unit_fits.unit_scores import complete_scores

    results, model_hash = _of_one_model(results, model_hash)
    with progress() as tell:
        trusting(kept_model(results, model_hash), trust)
        scores = complete_scores(results, model_hash, lambda done, all_: tell(f"scores of {done} of {all_} campaigns"))
        tell("adding up the evidence")
        units = read_units(results, model_hash)
        found = pooled_discovery(scores.table, units)
    if picture is not None:
        from imubayes_archive.display.figures.batch import evidence_picture

        evidence_picture(found, units).save(picture)
    show(lambda: found, lambda: discovery_report(found, scores.issues), as_json)


@batch.command
def compare(
    old: Path, new: Path, *, out: Path | None = None, picture: Path | None = None, as_json: Json = False
) -> None:
    """Compare the results of two models: changes by parameter and unit, with significance.

    Example: imubayes batch compare results/old results/new --out changes.parquet

    Parameters
    ----------
    old
        Results of the old model: a results folder, or RESULTS/model-HASH.
    new
        Results of the new model.
    out
        Parquet file to write: every change.
    picture
        PNG file to write: the changes of every parameter.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes_archive.display.batch_report import comparison_report
    from imubayes_archive.population.model_comparison import compare_models

    found, changes = compare_models(_tables(old, None), _tables(new, None))
    _write(changes, out)
    if picture is not None:
        from imubayes_archive.display.figures.batch import change_picture

        change_picture(changes).save(picture)
    show(lambda: found, lambda: comparison_report(found), as_json)


@batch.command
def drift(
    results: Path,
    *,
    out: Path | None = None,
    picture: Path | None = None,
    model_hash: str | None = None,
    as_json: Json = False,
) -> None:
    """Show the drift between calibrations of one unit. For trends over units: `batch population`.

    Example: imubayes batch drift results/batch --out drifts.parquet

    Parameters
    ----------
    results
        Results folder of a batch.
    out
        Parquet file to write: every change between two calibrations of a unit.
    picture
        PNG file to write: estimates over dates of the parameters with the clearest drift.
    model_hash
        Model, if the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes_archive.display.batch_report import drift_report
    from imubayes_archive.population.drift import dated_estimates, drifts

    tables = _tables(results, model_hash)
    found, changes = drifts(*tables)
    _write(changes, out)
    if picture is not None:
        from imubayes_archive.display.figures.batch import drift_picture

        estimates = dated_estimates(*tables)
        # Of units that were calibrated once, the calibrations are drawn all the same.
        every = dict.fromkeys(estimates["parameter"]) if estimates.height else ()
        names = [each.parameter for each in found.parameters] or [*every]
        drift_picture(estimates, names).save(picture)
    show(lambda: found, lambda: drift_report(found), as_json)


archive = cyclopts.App(
    name="archive",
    help="Keep many campaigns as one Parquet dataset: pack, list, check.\n\n"
    "Example: imubayes archive pack campaigns/A-7 campaigns/A-8 --out archive",
)


@archive.command
def pack(*folders: Path, out: Path, as_json: Json = False) -> int:
    """Add campaign folders to an archive. Existing campaigns are skipped, and nothing is rewritten.

    Example: imubayes archive pack campaigns --out archive

    Parameters
    ----------
    folders
        Campaign folders, or folders that contain such folders.
    out
        Archive to add to; created if there is none.
    as_json
        Print one JSON object on standard output.
    """
    with progress() as tell:
        from imubayes_archive.dataset import campaign_folders
        from imubayes_archive.dataset import pack as pack_folders
        from imubayes_archive.display.archive_report import packed_json, packed_report

        packed = pack_folders(campaign_folders(folders), out, tell)
    show(lambda: packed_json(packed), lambda: packed_report(packed, out), as_json)
    return 1 if packed.refused else 0


@archive.command(name="list")
def list_campaigns(archive: Path, *, as_json: Json = False) -> None:
    """List the campaigns of an archive, by unit and date.

    Example: imubayes archive list archive

    Parameters
    ----------
    archive
        Archive folder.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes_archive.dataset.store import open_archive
    from imubayes_archive.display.archive_report import list_json, list_report

    campaigns = open_archive(archive).campaigns()
    show(lambda: list_json(campaigns), lambda: list_report(campaigns), as_json)


@archive.command
def check(archive: Path, *, as_json: Json = False) -> int:
    """Read every campaign of an archive and verify its checksum, its name and its place.

    Example: imubayes archive check archive

    Parameters
    ----------
    archive
        Archive folder.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes_archive.dataset.store import open_archive
    from imubayes_archive.display.archive_report import archive_check, check_json

    opened = open_archive(archive)
    with progress() as tell:
        issues, files = opened.check(tell), len(opened.files())
    show(lambda: check_json(files, issues), lambda: archive_check(files, issues), as_json)
    return 1 if issues else 0
