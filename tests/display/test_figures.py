"""Pictures: drawn, captioned, with units, nothing outside the paper, readable if the data are odd."""

import json
import re
from collections.abc import Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import polars as pl
import pytest
import synthetic_results as made
from matplotlib import rcParams
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.dates import num2date
from matplotlib.text import Text
from matplotlib.transforms import Bbox

import imubayes_explorer as explorer
from imubayes.adequacy.adequacy_record import KnownNoiseFit, RunChi2
from imubayes.campaign import load_campaign
from imubayes.display.figure_style import FewTicks, Picture, picture
from imubayes.display.figures import (
    campaign_timeline_figure,
    corner_figure,
    identifiability_figure,
    measurement_figure,
    mounted_pairs,
    mounting_sketch_figure,
    prior_posterior_figure,
    residual_figure,
    run_chi2_figure,
    temperature_figure,
    thermal_courses,
)
from imubayes.display.figures.measurement import driver
from imubayes.display.figures.panels import neighbour_means, set_abscissa
from imubayes.display.figures.residual import HEAT
from imubayes.display.numbers_and_labels import covariate, ratio_text
from imubayes.display.residual_columns import covariates_of
from imubayes.results.summary import Summary
from imubayes.results.temperature_range import ThermalModel

DATA = Path(__file__).parents[2] / "data"


def texts_of(figure: Picture) -> Iterator[tuple[str, Bbox]]:
    """Yield every visible text with its place on the paper, in pixels."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    renderer = canvas.get_renderer()
    hidden = {id(label) for axes in figure.axes for axis in (axes.xaxis, axes.yaxis) for label in _undrawn(axis)}
    for text in figure.findobj(Text):
        if text.get_visible() and text.get_text().strip() and id(text) not in hidden:
            yield text.get_text(), text.get_window_extent(renderer)


def _undrawn(axis: Axis) -> list[Text]:
    """Return the labels of an axis that is hidden, and those of ticks beyond its limits."""
    low, high = sorted(axis.get_view_interval())
    ticks = (*axis.get_major_ticks(), *axis.get_minor_ticks())
    beyond = [tick for tick in ticks if not axis.get_visible() or not low <= tick.get_loc() <= high]
    return [label for tick in beyond for label in (tick.label1, tick.label2)]


def assert_readable(figure: Picture, touching: float = 0.0) -> None:
    """No text leaves the paper, none lies on another."""
    paper = figure.bbox
    placed = list(texts_of(figure))
    for text, box in placed:
        assert box.x0 >= paper.x0, text
        assert box.y0 >= paper.y0, text
        assert box.x1 <= paper.x1, text
        assert box.y1 <= paper.y1, text
    for place, (text, box) in enumerate(placed):
        for other, beside in placed[place + 1 :]:
            common = Bbox.intersection(box, beside)
            # Boxes hold the line's full height; a pixel of it is no overlap of letters.
            overlap = common is not None and min(common.width, common.height) > 1.5 + touching
            assert not overlap, f"{text!r} lies on {other!r}"
    assert figure.caption
    assert any(figure.caption[:30] in text for text, _ in placed)


@pytest.fixture(scope="module")
def residuals() -> pl.DataFrame:
    return made.trihedral_residuals()


@pytest.fixture(scope="module")
def summary(residuals: pl.DataFrame) -> Summary:
    return made.summary_of(residuals)


def test_measurement_of_a_run(residuals):
    for run in ("rate-pyramid-25C", "head-y-up-55C"):
        figure = measurement_figure(residuals, run)
        assert_readable(figure)
        assert len(figure.axes) == 12
        words = [text for text, _ in texts_of(figure)]
        assert {"gx", "az", "pulse/s", "deg/h", "µg"} <= set(words)
        assert "good model" in figure.caption


@pytest.mark.parametrize(
    "one",
    ["row", "time", *(pytest.param(one, marks=pytest.mark.slow) for one in ("power_on", "table_rate", "table_angle")),
     "temperature"],
)  # fmt: skip
def test_residuals_against_every_covariate(residuals, one):
    figure = residual_figure(residuals, one)
    assert_readable(figure)
    assert len(figure.axes) == 12  # six channels twice
    assert "good model" in figure.caption


def test_rows_without_the_covariate_are_counted(residuals):
    assert "left out: means over whole turns" in residual_figure(residuals, "table_angle").caption
    assert "left out" not in residual_figure(residuals, "time").caption


def test_covariates_that_are_missing_or_constant_are_skipped(residuals):
    keys = [one.name for one in covariates_of(residuals)]
    assert keys == ["row", "time", "power_on", "table_rate", "table_angle", "temperature"]
    assert [one.name for one in covariates_of(made.tumble_residuals())] == ["row", "time"]
    with pytest.raises(ValueError, match="no injected current that varies"):
        residual_figure(residuals, "current")
    with pytest.raises(KeyError, match="is not a covariate"):
        residual_figure(residuals, "humidity")


def test_what_drives_a_run():
    frame = made.trihedral_residuals(temperatures=(25,))
    runs = {"rate-x-up-25C": "table_rate", "head-x-up-25C": "table_angle"}
    assert {run: driver(frame.filter(pl.col("run") == run)).name for run in runs} == runs
    thermal = made.thermal_residuals()
    assert driver(thermal.filter(pl.col("run") == "ramp-1g")).name == "converter_temperature"
    assert driver(made.tumble_residuals()).name == "row"


def test_a_table_that_swings_is_shown_over_time_on_a_linear_axis():
    frame = made.trihedral_residuals(temperatures=(25,))
    own = frame.filter(pl.col("run") == "rate-x-up-25C")
    one = own.filter(pl.col("channel") == own["channel"][0])
    turn = np.linspace(0.0, 20.0, 60 * one.height)
    swung = pl.concat([one] * 60).with_columns(
        pl.Series("time_s", turn), pl.Series("table_rate_deg_s", 40 * np.sin(turn)), pl.Series("table_angle_deg", turn)
    )
    assert driver(swung).name == "time"
    axes = Picture().add_subplot()
    set_abscissa(axes, 40 * np.sin(turn), covariate("table_rate"))
    assert axes.get_xscale() == "linear"


def test_thirty_five_runs(residuals):
    many = made.trihedral_residuals(temperatures=(-40, -20, 25, 40, 60))
    assert_readable(residual_figure(many, "row"))
    assert_readable(run_chi2_figure(made.summary_of(many)))


@pytest.mark.slow
def test_hundred_runs_are_limited():
    many = made.trihedral_residuals(temperatures=tuple(range(-40, 60, 7)), channels=("gx", "ax"))
    figure = run_chi2_figure(made.summary_of(many))
    assert_readable(figure)
    assert "Shown: 40 of 105 runs" in figure.caption
    figure = residual_figure(many, "temperature")
    assert not any("… " in text and "more" in text for text, _ in texts_of(figure)), (
        "the legend has a line per mounting"
    )
    assert_readable(figure)


def test_many_channels_are_limited():
    random = np.random.default_rng(0)
    names = [f"g{i}" for i in range(9)]
    frame = made.rows_of("a", "rate_table", {"time_s": np.arange(20)}, {n: np.ones(20) for n in names}, random)
    frame = frame.with_columns(
        pl.when(pl.col("channel") == "g8").then(9.0).otherwise(pl.col("whitened")).alias("whitened")
    )
    figure = residual_figure(frame, "time")
    assert "the 6 of 9 channels with the largest residuals" in figure.caption
    assert any(text == "g8" for text, _ in texts_of(figure))
    assert_readable(figure)


def test_long_names_are_shortened(residuals):
    renamed = residuals.with_columns(pl.col("run") + "-with-a-name-that-nobody-would-want-to-read-in-full")
    assert_readable(residual_figure(renamed, "row"))
    assert_readable(run_chi2_figure(made.summary_of(renamed)))


def test_outliers_do_not_press_the_rest_flat(residuals):
    spoilt = residuals.with_columns(
        pl.when(pl.int_range(pl.len()) == 5).then(400.0).otherwise(pl.col("whitened")).alias("whitened")
    )
    figure = residual_figure(spoilt, "time")
    assert float(figure.axes[1].get_ylim()[1]) < 20
    assert any("1 beyond the axis" in text for text, _ in texts_of(figure))


def test_chi2_map_makes_misfit_stand_out():
    planted = made.summary_of(made.trihedral_residuals(planted=True))
    figure = run_chi2_figure(planted)
    assert_readable(figure)
    light = np.array([patch.get_facecolor()[:3] for patch in figure.axes[0].patches]).mean(axis=1)
    ratios = np.array([float(text.get_text()) for text in figure.axes[0].texts])
    order = np.argsort(ratios, kind="stable")
    assert np.all(np.diff(light[order][ratios[order] >= 1.05]) <= 0.02)  # light to dark, up to the worst
    assert light[order[-1]] < 0.15 < 0.9 < light[ratios <= 1].min()
    bold = [text.get_fontweight() == "bold" for text in figure.axes[0].texts]
    assert np.count_nonzero(bold) >= 36  # three gyros in twelve runs on the rate table
    assert not np.any(np.array(bold)[ratios < 1])
    [legend] = figure.legends
    assert legend.get_texts()[-1].get_text() == f"{ratio_text(ratios.max())}, the worst cell"


def test_chi2_map_is_at_the_noise_known_beforehand():
    """A noise that the fit raised does not hide the misfit: cells, bold letters and caption are at the known one."""
    fitted = made.summary_of(made.trihedral_residuals())
    runs = tuple(RunChi2(run=each.name, channel=each.channel, n=each.n, chi2=50.0 * each.n) for each in fitted.runs)
    known = KnownNoiseFit(chi2=1.0, dof=1.0, channels=(), runs=runs)
    figure = run_chi2_figure(fitted.model_copy(update={"known_noise": known}))
    assert_readable(figure)
    assert {text.get_text() for text in figure.axes[0].texts} == {"50.0"}
    assert "known beforehand" in figure.caption
    assert "as fitted" in run_chi2_figure(fitted).caption


def test_the_colours_of_page_and_picture_are_the_same():
    source = Path(explorer.__file__).with_name("page").joinpath("dom.js").read_text()
    [light] = re.findall(r"light: (\[\[.*?\]\]),\n  dark", source)
    assert tuple(map(tuple, json.loads(light))) == HEAT


def test_no_warning_and_no_title_is_cut(summary):
    words = "a statement that goes on and on, with the sizes of all that was found and the remedy for each of them; "
    failed = summary.model_copy(update={"converged": False, "message": 12 * words})
    said = "The reason is given at the head of the comparison."
    draws = {"scale_factor[gx]": 1000 + np.linspace(-1, 1, 500)}
    for figure in (corner_figure(draws, list(draws), failed), run_chi2_figure(failed), identifiability_figure(failed),
                   prior_posterior_figure(failed)):  # fmt: skip
        assert_readable(figure)
        assert any(said in text.replace("\n", " ") for text, _ in texts_of(figure))
    long = picture(7.0, 2.0, f"{'a long name of a run ' * 6}ENDS HERE", "Caption.")
    assert_readable(long)
    assert any("ENDS HERE" in text.replace("\n", " ") for text, _ in texts_of(long))


def test_corner(summary):
    names = ["mounting_angle[gx,pyramid]", "mounting_angle[gy,pyramid]", "scale_factor[gx]", "scale_factor[gy]"]
    posterior = made.posterior_of(summary)
    figure = corner_figure(posterior, names, summary)
    assert_readable(figure)
    assert len(figure.axes) == 10
    words = [text for text, _ in texts_of(figure)]
    assert {"Δ / arcsec", "Δ / ppm"} <= set(words)
    assert any("+0.6" in word for word in words)
    assert_readable(corner_figure(posterior["posterior"], names[:1], summary))
    assert_readable(corner_figure(posterior["posterior"].to_dataset(), names[:2], summary))
    with pytest.raises(ValueError, match=r"no draws of gyro_bias\.bias\[gq\]"):
        corner_figure(posterior, ["gyro_bias.bias[gq]"], summary)


def test_corner_of_a_quantity_kept_for_some_draws(summary):
    random = np.random.default_rng(1)
    values = 54.7 + 1e-4 * random.standard_normal(4000)
    values[::3] = np.nan
    draws = {"mounting_angle[gx,pyramid]": values, "scale_factor[gx]": 1000 + 0.01 * random.standard_normal(4000)}
    assert_readable(corner_figure(draws, list(draws), summary))


def test_corner_of_very_small_and_very_large_numbers(summary):
    random = np.random.default_rng(1).standard_normal((3, 2000))
    sizes = {"gyro_bias.bias[gx]": 2e-5, "accel_bias.bias[ax]": 3e5, "lever_arm.x[ax]": 0.4}
    draws = {name: size * column for (name, size), column in zip(sizes.items(), random, strict=True)}
    figure = corner_figure(draws, list(draws), summary)
    assert_readable(figure)
    words = {text for text, _ in texts_of(figure)}
    assert {"Δ / $10^{-6}$ deg/h", "Δ / g", "Δ / mm"} <= words


def test_unsampled_and_unconverged_are_said_in_the_picture(summary):
    draws = {"scale_factor[gx]": 1000 + np.linspace(-1, 1, 500)}
    words = [
        text for text, _ in texts_of(corner_figure(draws, list(draws), summary.model_copy(update={"sampled": False})))
    ]
    assert any("Laplace approximation" in word for word in words)
    failed = summary.model_copy(update={"converged": False, "message": "It stopped.", "sampled": False})
    for figure in (corner_figure(draws, list(draws), failed), run_chi2_figure(failed), identifiability_figure(failed)):
        assert any(word.startswith("NOT CONVERGED. It stopped.") for word, _ in texts_of(figure))


def test_prior_and_posterior(summary):
    figure = prior_posterior_figure(summary)
    assert_readable(figure)
    words = [text for text, _ in texts_of(figure)]
    assert "standard uncertainty / arcsec" in words
    assert_readable(prior_posterior_figure(summary, ["gyro_bias.bias[gx]", "accel_bias.bias[ax]"]))
    with pytest.raises(ValueError, match="no quantity"):
        prior_posterior_figure(summary, ["gyro_bias.bias[gq]"])


def test_identifiability(summary):
    figure = identifiability_figure(summary)
    assert_readable(figure)
    assert "The other" in figure.caption
    few = summary.model_copy(update={"parameters": summary.parameters[:3], "derived": ()})
    assert_readable(identifiability_figure(few))


def test_a_picture_shows_itself_and_leaves_the_style_alone(summary):
    before = dict(rcParams)
    figure = identifiability_figure(summary)
    assert figure._repr_png_().startswith(b"\x89PNG")
    assert dict(rcParams) == before


def test_means_of_neighbours():
    x = np.repeat([-10.0, 0.0, 10.0], 6)
    y = np.tile([1.0, 2.0, 3.0, 1.0, 2.0, 3.0], 3) + 0.1 * x
    place, mean, error = neighbour_means(x, y)
    np.testing.assert_allclose(place, [-10, 0, 10])
    np.testing.assert_allclose(mean, [1, 2, 3])
    np.testing.assert_allclose(error, np.std([1, 2, 3, 1, 2, 3], ddof=1) / np.sqrt(6))


@pytest.mark.parametrize(
    ("limits", "expected"),
    [((-5, 5), [-5, -2.5, 0, 2.5, 5]), ((-3.2, 3.2), [-2, 0, 2]), ((19960.2, 19961.3), [19960.5, 19961.0])],
)
def test_few_round_ticks(limits, expected):
    assert FewTicks().tick_values(*limits) == expected


def test_angles_are_ticked_in_eighths_of_a_turn():
    axes = Picture().add_subplot()
    set_abscissa(axes, np.array([0.0, 360.0]), covariate("table_angle"))
    assert set(axes.get_xticks()) >= {0, 90, 180, 270, 360}
    assert not set(axes.get_xticks() % 45) - {0}


def test_rates_are_ticked_in_decades():
    axes = Picture().add_subplot()
    set_abscissa(axes, np.array([-300.0, -1.0, 0.0, 1.0, 300.0]), covariate("table_rate"))
    labels = {axes.xaxis.get_major_formatter()(place) for place in axes.get_xticks()}
    assert labels >= {"−100", "−10", "−1", "0", "1", "10", "100"}


def test_labels_of_many_decades_of_rate_do_not_touch():
    figure = picture(8.0, 2.0, "", "")
    axes = figure.add_axes((0.1, 0.3, 0.38, 0.6))  # half the width of a figure, as residuals beside whitened ones
    set_abscissa(axes, np.array([-300.0, -1e-5, 0.0, 0.004, 300.0]), covariate("table_rate"))
    figure.draw_without_rendering()
    boxes = sorted((each.get_window_extent() for each in axes.get_xticklabels() if each.get_text()), key=lambda b: b.x0)
    assert len(boxes) >= 5
    assert all(one.x1 + 2 < other.x0 for one, other in pairwise(boxes))


def test_bias_and_scale_factor_over_temperature():
    """The line is bias + slope (T − T_ref) of the draws, and the band opens away from T_ref."""
    campaign = load_campaign(DATA / "full-qualification")
    random = np.random.default_rng(1)
    units = {"gyro_bias.bias[gx]": "deg/h", "gyro_bias_temperature.slope[gx]": "deg/h/degC", "x": "1"}
    draws = {
        "gyro_bias.bias[gx]": 5 + 0.1 * random.normal(size=2000),
        "gyro_bias_temperature.slope[gx]": 0.3 + 0.02 * random.normal(size=2000),
        "gyro_bias.bias[gy]": random.normal(size=2000),
    }
    thermal = ThermalModel({"gyro_bias_temperature": 20.0}, units, 25.0)
    courses = thermal_courses(campaign, draws, thermal)
    assert list(courses) == ["gx"]
    course, scale = courses["gx"]
    assert course is not None
    assert scale is None
    assert course.values.mean(axis=0) == pytest.approx(5 + 0.3 * (course.temperature - 20), abs=0.1)
    width = np.hypot(0.1, 0.02 * (course.temperature - 20))
    assert course.values.std(axis=0) == pytest.approx(width, rel=0.1)
    figure = temperature_figure(campaign, courses)
    assert_readable(figure)
    marks = figure.axes[0].lines[-1].get_xdata()
    assert len(marks) == sum("temperature" in run.covariates for run in campaign.runs)
    cool = replace(campaign, runs=tuple(replace(run, covariates={}) for run in campaign.runs))
    assert thermal_courses(cool, draws, thermal) == {}


def test_runs_on_a_time_axis():
    campaign = load_campaign(DATA / "full-qualification")
    figure = campaign_timeline_figure(campaign)
    assert_readable(figure)
    upper = figure.axes[0]
    bars = [line for line in upper.lines if line.get_linewidth() == 8]
    assert len(bars) == len(campaign.runs)
    first = campaign.runs[0]
    assert num2date(bars[0].get_xdata()[0]).isoformat() == first.start
    seconds = 86400 * float(np.ptp(bars[0].get_xdata()))
    assert seconds == pytest.approx(first.covariates["time"].max(), abs=1e-3)
    hues = {run.mounting: line.get_color() for run, line in zip(campaign.runs, bars, strict=True)}
    assert len(set(hues.values())) == len(hues)
    without = replace(campaign, runs=tuple(replace(run, start=None) for run in campaign.runs))
    with pytest.raises(ValueError, match="no run states its start"):
        campaign_timeline_figure(without)


@pytest.mark.parametrize(
    "name",
    [*(pytest.param(name, marks=pytest.mark.slow) for name in ("trihedral-imu", "multi-axis-table", "redundant-imu")),
     "polar-tumble", "centrifuge"],
)  # fmt: skip
def test_mountings_are_sketched(name):
    campaign = load_campaign(DATA / name)
    pairs = mounted_pairs(campaign)
    figure = mounting_sketch_figure(campaign, pairs[:6])
    assert_readable(figure, touching=2.0)
    titles = [axes.get_title(loc="left") for axes in figure.axes if axes.get_title(loc="left")]
    assert len(titles) == min(len(pairs), 6)
    for (table, mounting), title in zip(pairs[:6], titles, strict=True):
        count = sum((run.table, run.mounting) == (table, mounting) for run in campaign.runs)
        assert title.startswith(f"{mounting} on {table}, {count} run")


def labelled(axes: Axes) -> dict[str, np.ndarray]:
    return {text.get_text().partition(":")[0]: np.array(text.get_position()) for text in axes.texts}


def test_a_sketch_shows_which_axis_is_up_and_the_positive_sense():
    """Seen from the south and above: up is up, East is to the right, and a positive turn about up or East goes left."""
    campaign = load_campaign(DATA / "trihedral-imu")
    pairs = mounted_pairs(campaign)
    figure = mounting_sketch_figure(campaign, pairs)
    for axes, (table, mounting) in zip(figure.axes, pairs, strict=False):
        at, expected = labelled(axes), mounting.removesuffix("-up")
        if mounting == "pyramid":
            assert np.ptp([float(value) for value in re.findall(r"([\d.]+)°", axes.texts[-1].get_text())]) == 0
            continue
        highest = max("xyz", key=lambda name: at[name][1])
        farthest = max("xyz", key=lambda name: at[name][0])
        assert (highest if table == "rate" else farthest) == expected
        assert f"{expected} 0°" in axes.texts[-1].get_text()
        arc = max((line.get_xydata() for line in axes.lines), key=len)
        first, last = np.asarray(arc)[[0, -1]]
        assert first[0] * last[1] - first[1] * last[0] > 0


def test_without_a_table_there_is_nothing_to_sketch():
    with pytest.raises(ValueError, match="no run has a table and a mounting"):
        mounting_sketch_figure(load_campaign(DATA / "desk-imu"))
