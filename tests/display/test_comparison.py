"""`compare`: the files it makes, what it keeps and removes, and what it says of a folder it cannot use."""

import json
import re
import shutil
from functools import partial
from pathlib import Path

import h5py
import numpy as np
import polars as pl
import pytest
import synthetic_results as made
import xarray as xr
from made_diagnoses import diagnosis
from markupsafe import Markup
from PIL import Image
from test_figures import assert_readable

from imubayes.criticism.diagnosis_record import CovariateLabel
from imubayes.display.compare_report import Comparison, comparison_page, print_comparison
from imubayes.display.compare_report import compare as compare_first
from imubayes.display.figure_selection import corner_choice, most_telling_first, pattern, plan
from imubayes.display.fit_cautions import alarm_in_picture, alarm_of
from imubayes.display.fit_report import summary_html
from imubayes.display.named_covariate import named_covariate
from imubayes.display.numbers_and_labels import covariate
from imubayes.foundations.errors import InputError, NotKept
from imubayes.results.change_records import write_diagnosis
from imubayes.results.stored_tables import draws_of
from kept_results import listed
from page_outline import assert_accessible

compare = partial(compare_first, every=True)


def test_all_pictures_are_made_with_captions(compared: Comparison, trihedral: Path):
    names = [path.name for path in compared.pictures]
    overview = ["fit-of-runs.png", "identifiability.png", "mounting-prior-posterior.png", "corner.png"]
    covariates = ["row", "time", "power-on", "table-rate", "table-angle", "temperature"]
    assert set(names[:10]) == {*overview, *(f"residuals-{one}.png" for one in covariates)}
    assert sum(name.startswith("run-") for name in names) == 6
    folder = trihedral / "figures"
    assert {path.name for path in folder.iterdir()} == {*names, "captions.json"}
    captions = json.loads((folder / "captions.json").read_text())
    assert captions == compared.captions
    assert all(len(caption) > 60 for caption in captions.values())
    for path in compared.pictures:
        with Image.open(path) as image:
            image.verify()
        with Image.open(path) as image:
            assert 600 <= image.width <= 1400
            assert np.asarray(image.convert("L")).std() > 5


def test_the_page_shows_five_figures_first(compared: Comparison, trihedral: Path):
    page = compared.page.read_text(encoding="utf-8")
    assert compared.page == trihedral / "compare.html"
    files = re.findall(r'<img [^>]*src="figures/([^"]*)"', page)
    assert sorted(files) == sorted(path.name for path in compared.pictures)
    assert [files[place] for place in (0, 3, 4)] == [
        "fit-of-runs.png", "mounting-prior-posterior.png", "identifiability.png"
    ]  # fmt: skip
    assert files[1].startswith("residuals-")
    assert files[2].startswith("run-")
    assert page.index('<h2 id="others">') > page.index(f"figures/{files[4]}")
    assert not re.search(r"<script|<link|@import|https?:", page)


def test_the_page_is_walked_without_a_mouse(compared: Comparison):
    assert_accessible(compared.page.read_text(encoding="utf-8"))


def test_a_long_warning_stands_once_at_the_head(compared: Comparison):
    """The picture says that there is one, and where; a short one is said in the picture."""
    words = f"The fit stopped, {'and its message goes on and on; ' * 8}THE END."
    failed = compared.summary.model_copy(update={"converged": False, "sampled": False, "message": words})
    tables = Markup(summary_html(failed, alarm=False))
    page = comparison_page("a title", tables, [], {}, (), alarm_of(failed))
    assert page.count("THE END.") == 1
    assert page.index("THE END.") < page.index("<main>")
    assert summary_html(failed).count("THE END.") == 1
    assert alarm_in_picture(failed) == "NOT CONVERGED. The reason is given at the head of the comparison."
    brief = failed.model_copy(update={"message": "It stopped."})
    assert alarm_in_picture(brief) == alarm_of(brief) == "NOT CONVERGED. It stopped."


@pytest.mark.slow
def test_five_figures_are_drawn_and_those_asked_for(compared: Comparison, trihedral: Path, tmp_path: Path):
    folder = Path(shutil.copytree(trihedral, tmp_path / "few"))
    few = compare_first(folder)
    assert len(few.pictures) == 5
    assert {path.name for path in (folder / "figures").iterdir()} == {*few.captions, "captions.json"}
    first = re.findall(r'<img [^>]*src="figures/([^"]*)"', few.page.read_text(encoding="utf-8"))
    assert sorted(first) == sorted(few.captions)
    more = len(compared.pictures) - 6
    assert few.notes == (f"--every draws {more} more figures and a corner plot; --runs NAME… draws single runs.",)
    asked = compare_first(folder, runs=["rate-y-up-25C"], parameters=["gyro_bias.bias[gx]"])
    assert {"corner.png", "run-rate-y-up-25C.png"} <= set(asked.captions)


def test_the_clearest_pattern_comes_first():
    """A residual that follows the temperature puts its figure before those against other covariates."""
    residuals = made.trihedral_residuals(temperatures=(-40, 25, 60), channels=("gx", "ax"))
    planted = residuals.with_columns(pl.col("whitened") + pl.col("temperature_degC") / 40)
    for frame, first in ((planted, "residuals-temperature"), (residuals, None)):
        names = ["residuals-time", "residuals-temperature", "residuals-table-rate", "fit-of-runs"]
        ranked = most_telling_first(names, made.summary_of(frame), frame, [])
        assert ranked[0] == "fit-of-runs"
        assert first is None or ranked[1] == first
    clearest = {each.name: pattern(planted, each) for each in map(covariate, ("temperature", "table_rate"))}
    assert clearest["temperature"] > 10 > 3 > pattern(residuals, covariate("temperature"))
    assert clearest["temperature"] > clearest["table_rate"]


def named_by(name: str | None, folder: Path) -> None:
    """Put a diagnosis into a folder, whose first group goes with a covariate."""
    label = None if name is None else CovariateLabel(name=name, unit="deg/s", phrase="the covariate that is named")
    found = diagnosis()
    [group] = found.groups
    groups = (group.model_copy(update={"covariate": label}),)
    write_diagnosis(folder, found.model_copy(update={"groups": groups}))


def test_the_covariate_that_the_diagnosis_names_is_drawn_first(tmp_path: Path):
    """A recorded one, and the input of the channels, which no run table has; one of which nothing is known is not."""
    residuals = made.trihedral_residuals(temperatures=(-40, 25, 60), channels=("gx", "gy", "ax"))
    kinds = {"gx": "gyro", "gy": "gyro", "ax": "accelerometer"}
    residuals = residuals.with_columns(pl.col("channel").replace_strict(kinds).alias("kind"))
    summary = made.summary_of(residuals)
    folder = made.write_folder(tmp_path / "named", residuals, summary)
    assert named_covariate(folder, residuals) is None
    for name, file in (("time_s", "residuals-time"), ("rate_i", "residuals-rate-i")):
        named_by(name, folder)
        named = named_covariate(folder, residuals)
        figures = dict(plan(summary, residuals, [], {}, [], named=named))
        assert most_telling_first(list(figures), summary, residuals, [], named)[1] == file
        drawn = figures[file]()
        assert_readable(drawn)
        shown = {axes.get_title(loc="left") for axes in drawn.axes}
        assert ("ax" in shown) == (name == "time_s")
    for nothing in (None, "rate_o"):
        named_by(nothing, folder)
        assert named_covariate(folder, residuals) is None


def test_chosen_runs(tmp_path: Path):
    residuals = made.trihedral_residuals(temperatures=(25,), channels=("gx",))
    folder = made.write_folder(tmp_path / "runs", residuals, made.summary_of(residuals, sampled=False))
    found = compare(folder, runs=["rate-y-up-25C"])
    assert [path.name for path in found.pictures if path.name.startswith("run-")] == ["run-rate-y-up-25C.png"]
    assert any("--runs all" in note for note in found.notes)
    with pytest.raises(InputError) as caught:
        compare(folder, runs=["rate-y-up-26C"])
    assert caught.value.issues[0].allowed.startswith("rate-y-up-25C")


def test_it_shows_itself(compared: Comparison):
    assert compared.converged
    assert len(compared.tables) == 6
    assert compared._repr_html_().startswith("<div")


@pytest.mark.slow
def test_a_tumble_without_table_and_without_samples(tumble: Path):
    found = compare(tumble)
    names = [path.name for path in found.pictures]
    assert "corner.png" not in names
    assert {"run-tumble-1.png", "run-tumble-2.png", "residuals-time.png", "residuals-row-2.png"} <= set(names)
    assert not any("table" in name for name in names)
    assert any("No corner plot" in note for note in found.notes)


def test_one_run_of_one_channel(single: Path):
    names = {path.name for path in compare(single).pictures}
    assert {"fit-of-runs.png", "run-rate-pyramid-25C.png", "residuals-table-rate.png"} <= names


@pytest.mark.slow
def test_two_rows_are_enough(tmp_path: Path):
    residuals = made.trihedral_residuals(temperatures=(25,), channels=("gx",))
    residuals = residuals.filter(pl.col("run") == "rate-pyramid-25C").head(2)
    folder = made.write_folder(tmp_path / "two", residuals, made.summary_of(residuals, sampled=False))
    assert compare(folder).pictures
    folder = made.write_folder(tmp_path / "one", residuals.head(1), made.summary_of(residuals.head(1), sampled=False))
    assert compare(folder).pictures


@pytest.mark.slow
def test_missing_values_are_left_out(tmp_path: Path):
    residuals = made.trihedral_residuals(temperatures=(25,), channels=("gx", "ax"))
    holes = pl.int_range(pl.len()) % 7 == 0
    columns = ("observed", "residual", "input_residual", "whitened")
    residuals = residuals.with_columns(pl.when(holes).then(None).otherwise(pl.col(one)).alias(one) for one in columns)
    folder = made.write_folder(
        tmp_path / "holes", residuals, made.summary_of(residuals.drop_nulls("whitened"), sampled=False)
    )
    assert len(compare(folder).pictures) > 10


@pytest.mark.slow
def test_a_fit_that_failed_is_still_shown(tmp_path: Path):
    residuals = made.trihedral_residuals(temperatures=(25,), channels=("gx",))
    parameters, derived = made.trihedral_quantities()
    parameters, derived = made.without_estimates(parameters), made.without_estimates(derived)
    more = {"converged": False, "message": "The fit did not converge.", "sampled": False}
    summary = made.summary_of(residuals, parameters, derived, **more)
    found = compare(made.write_folder(tmp_path / "failed", residuals, summary))
    assert not found.converged
    assert "identifiability.png" not in {path.name for path in found.pictures}


@pytest.mark.slow
def test_awkward_names_of_runs_make_safe_files(tmp_path: Path):
    residuals = made.trihedral_residuals(temperatures=(25,), channels=("gx",))
    awkward = {"rate-x-up-25C": "../a/b", "rate-y-up-25C": "$x_1$ ü", "rate-z-up-25C": "A", "rate-pyramid-25C": "a"}
    residuals = residuals.filter(pl.col("run").is_in(list(awkward))).with_columns(pl.col("run").replace(awkward))
    folder = made.write_folder(tmp_path / "awkward", residuals, made.summary_of(residuals, sampled=False))
    names = {path.name for path in compare(folder).pictures}
    assert {"run-.._a_b.png", "run-_x_1___.png", "run-A.png", "run-a_2.png"} <= names
    assert all((folder / "figures" / name).is_file() for name in names)


@pytest.mark.slow
def test_what_an_earlier_comparison_drew_goes_and_the_rest_stays(single: Path):
    compare(single)
    figures = single / "figures"
    (figures / "my-own.png").write_bytes(b"kept")
    shorter = pl.read_parquet(single / "residuals.parquet").drop("table_rate_deg_s")
    shorter.write_parquet(single / "residuals.parquet")
    listed(single)
    compare(single)
    names = {path.name for path in figures.iterdir()}
    assert "residuals-table-rate.png" not in names
    assert {"my-own.png", "residuals-time.png"} <= names
    assert not any(name.endswith(".part") for name in names)


@pytest.mark.slow
def test_chosen_parameters(tmp_path: Path):
    folder = made.trihedral_folder(tmp_path / "sampled", temperatures=(25,), channels=("gx",))
    assert "corner.png" in {path.name for path in compare(folder, ["gyro_bias.bias[gx]", "accel_bias.bias"]).pictures}
    with pytest.raises(InputError) as caught:
        compare(folder, ["gyro_bias.bais[gx]", "humidity"])
    assert len(caught.value.issues) == 2
    assert caught.value.issues[0].allowed.startswith("gyro_bias.bias[gx]")


def test_default_choice_pairs_angles_with_scale_factors():
    summary = made.summary_of(made.trihedral_residuals(temperatures=(25,)))
    angles = [f"mounting_angle[{channel},pyramid]" for channel in made.GYROS]
    assert corner_choice(summary, {}) == [*angles, *(f"scale_factor[{channel}]" for channel in made.GYROS)]
    assert len(corner_choice(summary.model_copy(update={"derived": ()}), {})) == 6


def test_correlated_pairs_are_chosen_and_names_of_one_quantity_are_not():
    summary = made.summary_of(made.trihedral_residuals(temperatures=(25,)))
    random = np.random.default_rng(1)
    draws = {entry.name: random.normal(size=2000) for entry in (*summary.parameters, *summary.derived)}
    first, second, third, fourth = (entry.name for entry in summary.derived[:4])
    draws[second] = draws[first] + 0.1 * draws[second]
    draws[fourth] = 3 * draws[third]
    assert set(corner_choice(summary, draws)) == {first, second}
    one, other = (entry.name for entry in summary.parameters[:2])
    draws[other] = draws[other] - draws[one]
    assert set(corner_choice(summary, draws)) == {first, second, one, other}


def test_draws_from_file_tree_and_arviz_agree(trihedral: Path):
    file = trihedral / "posterior.nc"
    names = [
        "gyro_bias.bias[gy]",
        "mounting_angle[ax,pyramid]",
        "table_rate_error.rate_error[rate]",
        "scale_factor[gz]",
    ]
    from_file = draws_of(file, [*names, "gyro_bias.bias[gq]", "nothing"])
    assert list(from_file) == names
    with xr.open_datatree(file, engine="h5netcdf") as tree:
        from_tree = draws_of(tree, names)
        expected = np.ravel(tree["posterior"]["mounting_angle"].sel(channel="ax", mounting="pyramid").to_numpy())
    for name in names:
        np.testing.assert_array_equal(from_file[name], from_tree[name])
    np.testing.assert_array_equal(from_file[names[1]], expected)


def test_draws_of_a_variable_with_and_without_labels():
    values = np.arange(12.0).reshape(2, 3, 2)
    labels = {"channel": ["gx", "gy"], "mounting": ["up, north"]}
    labelled = xr.DataArray(values[..., None], dims=("chain", "draw", *labels), coords=labels)
    data = xr.Dataset({"f": labelled, "s": (("draw", "chain"), values[..., 0].T)})
    found = draws_of(data, ["f[gy,up, north]", "s[all]"])
    np.testing.assert_array_equal(found["f[gy,up, north]"], values[..., 1].reshape(-1))
    np.testing.assert_array_equal(found["s[all]"], values[..., 0].reshape(-1))


@pytest.fixture
def spoilt(trihedral: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(trihedral, tmp_path / "spoilt", ignore=shutil.ignore_patterns("figures")))


def _edit(folder: Path, **changes) -> None:
    file = folder / "summary.json"
    content = json.loads(file.read_text()) | changes
    file.write_text(json.dumps({key: value for key, value in content.items() if value != "gone"}))


def _cut(file: Path) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


SPOILERS = {
    "no folder": lambda folder: shutil.rmtree(folder),
    "a file": lambda folder: (shutil.rmtree(folder), folder.write_text("")),
    "no summary": lambda folder: (folder / "summary.json").unlink(),
    "no residuals": lambda folder: (folder / "residuals.parquet").unlink(),
    "no posterior": lambda folder: (folder / "posterior.nc").unlink(),
    "summary cut": lambda folder: _cut(folder / "summary.json"),
    "summary not text": lambda folder: (folder / "summary.json").write_bytes(b"\xff\xfe\x00"),
    "summary a list": lambda folder: (folder / "summary.json").write_text("[]"),
    "other format": lambda folder: _edit(folder, format=2),
    "no parameters": lambda folder: _edit(folder, parameters="gone"),
    "parameters not a list": lambda folder: _edit(folder, parameters={"a": 1}),
    "parameter without unit": lambda folder: _edit(folder, parameters=[{"name": "a"}]),
    "residuals cut": lambda folder: _cut(folder / "residuals.parquet"),
    "residuals not parquet": lambda folder: (folder / "residuals.parquet").write_text("run,row\n"),
    "column missing": lambda folder: (
        pl.read_parquet(folder / "residuals.parquet").drop("whitened").write_parquet(folder / "residuals.parquet")
    ),
    "no rows": lambda folder: (
        pl.read_parquet(folder / "residuals.parquet").clear().write_parquet(folder / "residuals.parquet")
    ),
    "posterior cut": lambda folder: _cut(folder / "posterior.nc"),
    "posterior not netCDF": lambda folder: (folder / "posterior.nc").write_text("draws"),
    "posterior empty": lambda folder: h5py.File(folder / "posterior.nc", "w").close(),
}


@pytest.mark.parametrize("name", SPOILERS)
def test_a_folder_that_cannot_be_used_is_said_in_four_parts(spoilt: Path, name: str):
    SPOILERS[name](spoilt)
    _refused(spoilt)
    if spoilt.is_dir():  # as if the fit had left it so
        _refused(listed(spoilt))
    assert not (spoilt / "figures").exists()


def _refused(folder: Path) -> None:
    with pytest.raises(InputError) as caught:
        compare(folder)
    for problem in caught.value.issues:
        assert problem.what
        assert "spoilt" in problem.where
        assert problem.allowed
        assert problem.remedy


def test_the_nearest_result_is_named(trihedral: Path):
    with pytest.raises(InputError) as caught:
        compare(trihedral.parent / "trihedrall")
    assert "trihedral" in caught.value.issues[0].allowed


@pytest.mark.slow
def test_the_tables_are_shown_where_no_figure_can_be_written(single: Path, capsys):
    (single / "figures").write_text("in the way")
    with pytest.warns(NotKept, match=re.escape(f"nothing of this is kept in {single} (File exists)")):
        shown = compare_first(single)
    assert not shown.pictures
    assert not shown.page.exists()
    print_comparison(shown)
    out = capsys.readouterr().out
    assert "gx" in out
    assert "figures" not in out
