"""An archive fitted with its population as prior: from campaign folders of an own simulation to lots by name."""

import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest
from accelerometer_archive import Archive, write_archive

import imubayes
from imubayes.cli.main import run
from imubayes.foundations.errors import InputError
from imubayes.foundations.progress import silent
from imubayes_archive.api.archives import BatchResult
from imubayes_archive.display.figures.population import population_picture
from imubayes_archive.display.population_page import population_page
from imubayes_archive.population.hierarchical_fit import hierarchical_fit, scale_priors
from imubayes_archive.population.unit_populations import unit_populations

BIAS, SLOPE = "accel_bias.bias[ax]", "accel_bias_temperature.slope[ax]"
ARCHIVE = Archive(units=12, lot=5, shift=40.0, run_scatter=0.2)


@pytest.fixture(scope="module")
def fitted(tmp_path_factory):
    folder = tmp_path_factory.mktemp("archive")
    truth = write_archive(folder, ARCHIVE, 7)
    return folder, truth, imubayes.batch(folder / "units", folder / "model.toml", folder / "out")


def scores(table: pl.DataFrame, truth: dict, parameter: str, key: str, value: str, sd: str) -> np.ndarray:
    rows = table.filter(pl.col("parameter") == parameter)
    true = np.array([truth[unit][key] for unit in rows["unit"]])
    return (rows[value].to_numpy() - true) / rows[sd].to_numpy()


def test_the_scatter_that_no_unit_determines_is_known_from_all(fitted):
    _, truth, fits = fitted
    found = hierarchical_fit(fits.folder, fits.model)
    assert (found.fitted, found.left_out) == (12, ())
    alone = scores(found.units, truth, BIAS, "bias", "estimate", "estimate_sd")
    given = scores(found.units, truth, BIAS, "bias", "shrunk", "shrunk_sd")
    rows = found.units.filter(pl.col("parameter") == BIAS)
    assert rows["shrunk_sd"].mean() < 0.6 * rows["estimate_sd"].mean()
    assert np.sqrt(np.mean(alone**2)) < 0.6
    assert 0.6 < np.sqrt(np.mean(given**2)) < 1.6
    scatter = next(each for each in found.populations.parameters if each.parameter == "run_scatter.tau[ax]")
    assert scatter.mean == pytest.approx(np.log(ARCHIVE.run_scatter), abs=3 * scatter.mean_sd)


def test_a_lot_is_listed_with_its_units_by_the_command(fitted, capsys):
    folder, truth, fits = fitted
    assert run(["batch", "population", str(fits.folder), "--picture", str(folder / "p.png")]) == 0
    said = " ".join(capsys.readouterr().out.split())
    lot = [unit for unit, own in truth.items() if own["lot"]]
    assert f"{SLOPE}: 2 groups of units, {', '.join(lot)} +" in said
    (finding,) = next(each for each in fits.population().parameters if each.parameter == SLOPE).laws.findings
    assert finding.groups[1].units == tuple(lot)
    assert finding.groups[1].offset == pytest.approx(ARCHIVE.shift, abs=4 * finding.groups[1].offset_sd)
    assert (folder / "p.png").stat().st_size > 10_000


def test_a_page_leads_from_each_unit_to_its_campaign_and_model(fitted, tmp_path):
    """All parameters with a population, those first whose units deviate; marks and names of units are links."""
    folder, _, fits = fitted
    page = population_page(fits.folder, silent)
    assert page is not None
    assert len(page.units) == ARCHIVE.units
    pictures = page.html.split("<figure ")[1:]
    assert SLOPE in pictures[0]
    names = [each.parameter for each in fits.population().parameters if each.mean is not None and each.spread]
    assert names
    assert all(name in page.html for name in names)
    for key, unit in page.units.items():
        assert f'href="unit/{key}"' in pictures[0]
        assert (unit.campaign() / "campaign.toml").is_file()
        assert unit.model.is_file()
        assert fits.folder not in unit.out.parents
    assert population_page(folder / "units", silent) is None
    assert population_page(tmp_path, silent) is None


def test_every_unit_is_within_its_panel(fitted):
    """Standard uncertainties of a scale may exceed half of it: on a logarithmic axis its points were cut off."""
    fits, name = fitted[2], "run_scatter.tau[ax]"
    found, units = fits.population(), fits.given_population()
    wide = [
        each.model_copy(update={"predictive_sd": 1.0}) if each.parameter == name else each for each in found.parameters
    ]
    mine = pl.col("parameter") == name
    units = units.with_columns(
        shrunk_sd=pl.when(mine).then(0.6 * pl.col("shrunk")).otherwise(pl.col("shrunk_sd")),
        estimate=pl.when(~mine).then(pl.col("estimate")),
    )
    found = found.model_copy(update={"parameters": tuple(wide)})
    picture = population_picture(found, units, [name, SLOPE])
    scatter, slope = picture.axes[:2]
    assert (scatter.get_xscale(), slope.get_xscale()) == ("log", "linear")
    for axes in (scatter, slope):
        low, high = axes.get_xlim()
        points = [line.get_xdata()[0] for line in axes.lines if line.get_marker() in ("o", "D", "X")]
        assert len(points) >= ARCHIVE.units
        assert all(low < point < high for point in points if np.isfinite(point))


def test_what_is_kept_is_not_fitted_again_and_damage_is_refused(fitted, tmp_path):
    _, _, fits = fitted
    copy = tmp_path / "out"
    shutil.copytree(fits.folder, copy)

    def refuses(tasks):
        raise AssertionError("fitted again")

    assert hierarchical_fit(copy, fits.model, refuses).fitted == 12
    for place in sorted(copy.rglob("*.parquet")):
        content = bytearray(place.read_bytes())
        content[len(content) // 2] ^= 4
        place.write_bytes(content)
        with pytest.raises(InputError, match="was altered since it was written"):
            BatchResult(copy, fits.model).population()
        content[len(content) // 2] ^= 4
        place.write_bytes(content)
    assert hierarchical_fit(copy, fits.model, refuses).fitted == 12


def test_a_new_unit_has_the_archive_as_prior_and_its_own_campaign_is_refused(fitted):
    folder, _, fits = fitted
    model = folder / "model.toml"
    with pytest.raises(InputError, match="is one of those that the population is from"):
        imubayes.fit(folder / "units" / "U003", model, sample=False, population=fits.folder)
    write_archive(folder / "later", Archive(units=1, run_scatter=0.2), 8)
    new = folder / "later" / "units" / "U901"
    (folder / "later" / "units" / "U001").rename(new)
    text = (new / "campaign.toml").read_text().replace("U001", "U901")
    (new / "campaign.toml").write_text(text)
    alone, given = (imubayes.fit(new, model, sample=False, population=prior) for prior in (None, fits.folder))
    assert given[BIAS].sd < 0.6 * alone[BIAS].sd
    assert given.summary.provenance.priors_from.startswith("the population of 12 units")
    assert alone.summary.provenance.priors_from == ""


def test_the_prior_of_a_scale_is_what_the_other_units_say_of_it(fitted):
    _, _, fits = fitted
    known = scale_priors(list(unit_populations(fits.parameters, fits.units)))
    digest = fits.units.filter(pl.col("unit") == "U002")["digest"][0]
    rest = (each.filter(pl.col("unit") != "U002") for each in (fits.parameters, fits.units))
    without = {each.table["parameter"][0]: each.population for each in unit_populations(*rest)}
    name = "run_scatter.tau[ax]"
    assert set(known[digest]) <= {name, "white_noise.sigma[ax]"}
    assert known[digest][name].mean == pytest.approx(without[name].mean, abs=0.2)
    assert known[digest][name].sd == pytest.approx(without[name].predictive_sd, rel=0.25)


@pytest.mark.slow
def test_units_given_their_population_are_within_their_uncertainty(tmp_path):
    """12 units with two runs each, 24 archives: rms of the normalised errors, and lots found."""
    errors, lots = {"bias": [], "slope": []}, 0
    for seed in range(24):
        folder = tmp_path / str(seed)
        truth = write_archive(folder, Archive(lot=4, run_scatter=(0.05, 0.2, 0.5)[seed % 3]), 500 + seed)
        fits = imubayes.batch(folder / "units", folder / "model.toml", folder / "out")
        table = fits.given_population()
        for key, parameter in (("bias", BIAS), ("slope", SLOPE)):
            errors[key].extend(scores(table, truth, parameter, key, "shrunk", "shrunk_sd"))
        lot = tuple(unit for unit, own in truth.items() if own["lot"])
        slope = next(each for each in fits.population().parameters if each.parameter == SLOPE)
        lots += any(group.units == lot for finding in slope.laws.findings for group in finding.groups)
    print({key: round(float(np.sqrt(np.mean(np.square(each)))), 3) for key, each in errors.items()}, f"{lots} of 24")
    assert lots >= 22
    for each in errors.values():
        assert 0.85 < np.sqrt(np.mean(np.square(each))) < 1.15


def test_campaigns_and_models_in_memory_are_fitted_as_their_files(fitted, tmp_path):
    folder, _, fits = fitted
    campaigns = [imubayes.load_campaign(folder / "units" / unit) for unit in ("U001", "U002")]
    found = imubayes.batch(campaigns, imubayes.load_model(folder / "model.toml"), tmp_path / "out")
    known = fits.parameters.filter(pl.col("unit").is_in(["U001", "U002"]))
    assert np.allclose(found.parameters["mean"].to_numpy(), known["mean"].to_numpy())
    assert imubayes.batch(campaigns, imubayes.load_model(folder / "model.toml"), tmp_path / "out").units.height == 2


@pytest.mark.slow
def test_a_test_that_was_not_run_is_predicted_from_the_population(tmp_path):
    """Units tested cold alone, with the archive as prior: their hot runs are as predicted, 10 units of 2 archives."""
    squares = readings = 0
    for seed in (900, 901):
        folder = tmp_path / str(seed)
        write_archive(folder, Archive(run_scatter=0.2), seed)
        fits = imubayes.batch(folder / "units", folder / "model.toml", folder / "out")
        write_archive(folder / "later", Archive(units=5, run_scatter=0.2), seed + 50)
        for place in range(1, 6):
            cold, hot = (later_unit(folder / "later", place, part) for part in ("cold", "hot"))
            fit = imubayes.fit(cold, folder / "model.toml", sample=False, population=fits.folder)
            found = imubayes.predict(fit, hot).summary
            assert found.verdict == "as_predicted"
            squares += sum(each.chi2 for each in found.runs)
            readings += sum(each.n for each in found.runs)
    assert readings == 160
    assert abs(squares - readings) < 3 * np.sqrt(2 * readings)


def later_unit(folder: Path, place: int, part: str) -> Path:
    """Return a copy of a unit under another name with its rows below 20 or above 40 degrees alone."""
    source, copy = folder / "units" / f"U{place:03d}", folder / f"{part}-{place}"
    shutil.copytree(source, copy)
    text = (copy / "campaign.toml").read_text().replace(f"U{place:03d}", f"N{place}")
    (copy / "campaign.toml").write_text(text.replace('"run-', f'"{part}-'))
    for file in (copy / "runs").iterdir():
        header, *rows = file.read_text().splitlines()
        warm = [float(row.split(",")[2]) for row in rows]
        kept = [
            row for row, degrees in zip(rows, warm, strict=True) if (degrees < 20 if part == "cold" else degrees > 40)
        ]
        file.write_text("\n".join([header, *kept]) + "\n")
    return copy
