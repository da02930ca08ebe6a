"""`imubayes noise`: table, record, figure, and priors that the fit of another campaign uses."""

import json
import shutil
from pathlib import Path

import numpy as np
import polars as pl
import pytest

from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.display.figures.allan import allan_figure
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.noise_analysis.noise_record import StaticNoise, fitted_deviations
from imubayes.noise_analysis.noise_spectra import NoiseTerm

SHIPPED = Path(__file__).parents[2] / "data" / "static-record"
# The truth of the shipped record, from its truth.toml.
WHITE = {"gx": 0.046617, "gy": 0.062794, "gz": 0.057912, "ax": 34.2869, "ay": 32.1530, "az": 27.2319}


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    out = tmp_path_factory.mktemp("noise")
    assert run(["noise", str(SHIPPED), "--out", str(out)]) == 0
    return out


@pytest.fixture(scope="module")
def record(written: Path) -> StaticNoise:
    return StaticNoise.model_validate_json((written / "noise.json").read_text())


def test_the_record_has_every_channel_with_units(record: StaticNoise):
    assert [channel.channel for channel in record.channels] == ["gx", "gy", "gz", "ax", "ay", "az"]
    assert record.probability == 0.95
    for channel in record.channels:
        white = channel.of(NoiseTerm.WHITE)
        assert white.unit == ("deg/sqrt(h)" if channel.kind == "gyro" else "ug/sqrt(Hz)")
        assert white.value is not None
        assert white.sd is not None
        assert abs(white.value - WHITE[channel.channel]) < 3 * white.sd


def test_quantisation_is_found_where_it_is(record: StaticNoise):
    found = {channel.channel: channel.of(NoiseTerm.QUANTISATION) for channel in record.channels}
    assert [name for name, term in found.items() if term.determined] == ["az"]
    assert found["az"].value == pytest.approx(4e-4, rel=0.04)
    assert all(term.upper_limit for name, term in found.items() if name != "az")


def test_the_fitted_curve_is_that_of_the_points(record: StaticNoise):
    for channel in record.channels:
        tau = np.array([point.tau_s for point in channel.allan])
        parts, total = fitted_deviations(channel, tau)
        np.testing.assert_allclose(total, [point.fitted for point in channel.allan], rtol=1e-9)
        assert set(parts) == {term.term for term in channel.terms if term.determined}
        # Short averaging times have the narrowest intervals, and no freedom to disagree.
        for point in channel.allan[:6]:
            assert point.fitted == pytest.approx(point.deviation, rel=0.06)
            assert point.low < point.deviation < point.high


def test_the_figure_shows_every_channel(record: StaticNoise, written: Path):
    figure = allan_figure(record.channels)
    assert [axes.get_title(loc="left") or axes.get_title() for axes in figure.axes] == list(WHITE)
    assert (written / "allan-night.png").stat().st_size > 20_000


def test_the_terms_are_priors_of_another_campaign_of_the_unit(written: Path, tmp_path: Path):
    """Ten one-minute rows at 100 Hz cannot tell the noise of a sample so well: the static record has told it."""
    out = tmp_path / "noise"
    assert run(["noise", str(SHIPPED), "--out", str(out), "--sample-rate", "100"]) == 0
    other = tmp_path / "other"
    shutil.copytree(SHIPPED, other)
    random, names = np.random.default_rng(1), list(WHITE)
    rows = {"time_s": 30.0 + 60.0 * np.arange(10), "samples": np.full(10, 6000.0)}
    rows |= {name: 1e-6 * random.normal(size=10) + (name == "az") for name in names}
    pl.DataFrame(rows).write_parquet(other / "runs" / "night.parquet")
    model = tmp_path / "model.toml"
    effects = 'format = 1\nname = "other"\n\n[[effect]]\nname = "gyro_bias"\n\n[[effect]]\nname = "accel_bias"\n\n'
    model.write_text(effects + (out / "noise-priors.toml").read_text())
    bound = bind(read_model(model), load_campaign(other))
    sigma = dict(zip(bound.hyper_layout.names, np.asarray(bound.problem.hyper_priors.values(np.zeros(6))), strict=True))
    for name in names:
        # deg/√h to deg/s: 1/60 per √s; µg to g: 1e-6; times the root of the sampling rate.
        expected = WHITE[name] * (1 / 60 if name[0] == "g" else 1e-6) * np.sqrt(100.0)
        assert sigma[f"white_noise.sigma[{name}]"] == pytest.approx(expected, rel=0.1)
    assert run(["fit", str(other), "--model", str(model), "--out", str(tmp_path / "fit"), "--no-sample"]) in (0, 1)
    found = json.loads((tmp_path / "fit" / "summary.json").read_text())["parameters"]
    fitted = next(p for p in found if p["name"] == "white_noise.sigma[gx]")
    assert fitted["prior_sd"] / fitted["mean"] < 0.05


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["noise", str(SHIPPED), "--runs", "day"], "'day' is no static record"),
        (["noise", str(SHIPPED.parent / "servo-table")], "there is no static record"),
        (["noise", str(SHIPPED), "--shortest-tau", "-1"], "a value of -1"),
        (["noise", str(SHIPPED), "--shortest-tau", "5000"], "too few octaves"),
    ],
)
def test_what_cannot_be_analysed_is_refused(words: list[str], what: str, capsys: pytest.CaptureFixture):
    assert run(words) == 2
    assert what in capsys.readouterr().err
