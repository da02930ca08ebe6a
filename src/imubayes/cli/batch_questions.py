"""`imubayes batch population|prior|diagnose|compare|trends`: questions asked of all units of a batch."""

from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.cli.batch import batch
from imubayes.cli.options import Json, print_json

if TYPE_CHECKING:
    import polars as pl

    from imubayes.display.report_layout import Report
    from imubayes.json_record import Record


def _of_one_model(results: Path, model_hash: str | None) -> tuple[Path, str | None]:
    """Return results folder and hash; the folder may also be that of one model, `RESULTS/model-<hash>`."""
    if results.name.startswith("model-") and model_hash is None:
        return results.parent, results.name.removeprefix("model-")
    return results, model_hash


def _tables(results: Path, model_hash: str | None) -> tuple["pl.DataFrame", "pl.DataFrame"]:
    """Return the tables of parameters and of units."""
    from imubayes.batch.posterior_table import read_parameters, read_units

    results, model_hash = _of_one_model(results, model_hash)
    return read_parameters(results, model_hash), read_units(results, model_hash)


def _write(table: "pl.DataFrame", file: Path | None) -> None:
    from imubayes.atomic_files import replacing

    if file is not None:
        with replacing(file) as scratch:
            table.write_parquet(scratch)


def _show(found: "Record", report: "Report", as_json: bool) -> None:
    from imubayes.display.report_layout import print_report

    if as_json:
        print_json(found.model_dump(mode="json"))
    else:
        print_report(report)


@batch.command
def population(
    results: Path,
    *,
    out: Path | None = None,
    picture: Path | None = None,
    model_hash: str | None = None,
    as_json: Json = False,
) -> int:
    """Show mean and spread of every parameter over the units, and the units that are unlike the others.

    Example: imubayes batch population results/batch --out units.parquet

    Parameters
    ----------
    results
        Results folder of a batch.
    out
        Parquet file to write: each unit with the population as its prior.
    picture
        PNG file to write: a strip of units for each parameter.
    model_hash
        Model, where the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.batch.parameter_population import populations
    from imubayes.display.batch_questions import population_report

    found, units = populations(*_tables(results, model_hash))
    _write(units, out)
    if picture is not None:
        from imubayes.display.figures.batch_pictures import population_picture

        population_picture(found, units).save(picture)
    _show(found, population_report(found), as_json)
    return 0


@batch.command
def prior(results: Path, *, out: Path, name: str = "", model_hash: str | None = None, as_json: Json = False) -> int:
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
        Model, where the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    """
    from dataclasses import asdict

    from imubayes.atomic_files import refuse_existing, write_text
    from imubayes.batch.next_prior import next_unit_model
    from imubayes.batch.parameter_population import populations
    from imubayes.batch.posterior_table import MODEL_FILE, model_folder
    from imubayes.display.batch_questions import prior_report
    from imubayes.display.report_layout import print_report
    from imubayes.model.model_file import read_carried_model
    from imubayes.results.result_folder import model_text

    found, _ = populations(*_tables(results, model_hash))
    folder, _ = _of_one_model(results, model_hash)
    spec, replaced = next_unit_model(read_carried_model(model_folder(folder, found.model) / MODEL_FILE), found, name)
    refuse_existing(out)
    write_text(out, model_text(spec))
    if as_json:
        print_json({"format": 1, "model": str(out), "priors": [asdict(each) for each in replaced]})
    else:
        print_report(prior_report(replaced, out))
    return 0


@batch.command
def diagnose(
    results: Path, *, picture: Path | None = None, model_hash: str | None = None, as_json: Json = False
) -> int:
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
        Model, where the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.cli.session import progress, start_jax

    start_jax()
    from imubayes.batch.pooled_discovery import pooled_discovery
    from imubayes.batch.posterior_table import read_units
    from imubayes.batch.score_files import complete_scores, read_unit_scores
    from imubayes.display.pooled_discovery_report import discovery_report

    results, model_hash = _of_one_model(results, model_hash)
    with progress() as tell:
        issues = complete_scores(results, model_hash, lambda done, all_: tell(f"scores of {done} of {all_} campaigns"))
        tell("adding up the evidence")
        units = read_units(results, model_hash)
        found = pooled_discovery(read_unit_scores(results, model_hash), units)
    if picture is not None:
        from imubayes.display.figures.batch_pictures import evidence_picture

        evidence_picture(found, units).save(picture)
    _show(found, discovery_report(found, issues), as_json)
    return 0


@batch.command
def compare(
    old: Path, new: Path, *, out: Path | None = None, picture: Path | None = None, as_json: Json = False
) -> int:
    """Show what changed with the model: per parameter and unit, with significance.

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
    from imubayes.batch.compare_models import compare_models
    from imubayes.display.batch_questions import comparison_report

    found, changes = compare_models(_tables(old, None), _tables(new, None))
    _write(changes, out)
    if picture is not None:
        from imubayes.display.figures.batch_pictures import change_picture

        change_picture(changes).save(picture)
    _show(found, comparison_report(found), as_json)
    return 0


@batch.command
def trends(
    results: Path,
    *,
    out: Path | None = None,
    picture: Path | None = None,
    model_hash: str | None = None,
    as_json: Json = False,
) -> int:
    """Show trends over dates and serial numbers, and drift between calibrations of one unit.

    Example: imubayes batch trends results/batch --out drifts.parquet

    Parameters
    ----------
    results
        Results folder of a batch.
    out
        Parquet file to write: every change between two calibrations of a unit.
    picture
        PNG file to write: estimates over dates of the parameters with the clearest trends and drifts.
    model_hash
        Model, where the folder holds results of several.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.batch.trends import dated_estimates
    from imubayes.batch.trends import trends as trends_of
    from imubayes.display.batch_questions import trends_report

    tables = _tables(results, model_hash)
    found, changes = trends_of(*tables)
    _write(changes, out)
    if picture is not None:
        from imubayes.display.figures.batch_pictures import trend_picture

        names = dict.fromkeys(each.parameter for each in (*found.drifts[:3], *found.trends))
        trend_picture(dated_estimates(*tables), list(names)).save(picture)
    _show(found, trends_report(found), as_json)
    return 0
