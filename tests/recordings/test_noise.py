"""`imubayes noise`: table, record, figure, and priors that the fit of another campaign uses."""

from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.model.bind import bind
from imubayes.model.model_file import ModelSpec, read_model
from imubayes.results.result_folder import model_text
from imubayes_recordings.display.allan import allan_figure
from imubayes_recordings.display.noise_report import priors_text
from imubayes_recordings.noise_analysis.noise_record import StaticNoise, fitted_deviations
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm

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


def test_the_terms_are_priors_of_another_campaign_of_the_unit(record: StaticNoise, written: Path, tmp_path: Path):
    (tmp_path / "priors.toml").write_text(priors_text(record, 100.0))
    assert (written / "noise-priors.toml").read_text() == priors_text(record)
    model = tmp_path / "model.toml"
    own = ["gyro_bias", "accel_bias", "white_noise", "random_walk_noise"]
    effects = "".join(f'[[effect]]\nname = "{name}"\n\n' for name in own)
    model.write_text(f'format = 1\nname = "other"\nnoise_priors = "priors.toml"\n\n{effects}')
    bound = bind(read_model(model), load_campaign(SHIPPED))
    names, size = bound.hyper_layout.names, len(bound.hyper_layout)
    median = dict(zip(names, np.asarray(bound.problem.hyper_priors.values(np.zeros(size))), strict=True))
    for name in WHITE:
        # deg/√h to deg/s: 1/60 per √s; µg to g: 1e-6; times the root of the sampling rate.
        expected = WHITE[name] * (1 / 60 if name[0] == "g" else 1e-6) * np.sqrt(100.0)
        assert median[f"white_noise.sigma[{name}]"] == pytest.approx(expected, rel=0.1)
        assert f"flicker_noise.b[{name}]" in names
        assert f"random_walk_noise.k[{name}]" in names
    assert [name for name in names if "pulse_quantisation" in name] == ["pulse_quantisation.q[az]"]
    # The truth is 2.62 °/h/√h: °/s over an hour, within the width of the prior.
    walk = next(p for p in bound.hyper_layout.parameters if p.name == "random_walk_noise.k[gx]")
    assert abs(float(walk.prior.z(2.624516534655075 / 3600))) < 3
    # Flicker noise and random walk share the scatter that they explain.
    places = [names.index("flicker_noise.b[gx]"), names.index("random_walk_noise.k[gx]")]
    assert bound.problem.hyper_correlation is not None
    root = np.asarray(bound.problem.hyper_correlation.root)
    assert (root @ root.T)[places[0], places[1]] < -0.2
    again = read_model_text(tmp_path / "again.toml", model_text(bound.spec))
    assert again.correlations[0].matrix == bound.spec.correlations[0].matrix


def test_ramp_and_markov_noise_are_priors_too(record: StaticNoise):
    """A record that determines them: its own terms stand in for those of this one."""
    gx = record.channels[0]
    found = {"determined": True, "value": 1.5, "sd": 0.2, "low": 1.1, "high": 1.9, "upper_limit": None}
    terms = [
        term.model_copy(update=found) if term.term in (NoiseTerm.RAMP, NoiseTerm.MARKOV) else term for term in gx.terms
    ]
    times = {"correlation_time_s": 300.0, "correlation_time_sd_s": 60.0, "correlated_terms": []}
    text = priors_text(record.model_copy(update={"channels": [gx.model_copy(update={"terms": terms, **times})]}))
    assert 'slope = "normal(0, 1.51327 deg/h/h)"' in text
    assert 'sigma = "lognormal(0.00040157' in text  # the middle of the logarithms of the ends, in °/s
    assert 'time = "lognormal(300 s, 0.2)"' in text


def read_model_text(file: Path, text: str) -> ModelSpec:
    file.write_text(text)
    return read_model(file)


@pytest.mark.parametrize(
    ("words", "what"),
    [
        (["noise", str(SHIPPED), "--runs", "day"], "'day' is not a static record"),
        (["noise", str(SHIPPED.parent / "servo-table")], "there is no static record"),
        (["noise", str(SHIPPED.parent / "hidden-thermal")], 'write procedure = "static_record" in the [[run]] of'),
        (["noise", str(SHIPPED), "--shortest-tau", "-1"], "a value of -1"),
        (["noise", str(SHIPPED), "--shortest-tau", "5000"], "too few octaves"),
    ],
)
def test_what_cannot_be_analysed_is_refused(words: list[str], what: str, capsys: pytest.CaptureFixture):
    assert run(words) == 2
    assert what in capsys.readouterr().err


def test_kalibr_has_its_file_without_a_fit(written: Path, record: StaticNoise):
    lines = [line for line in (written / "imu.yaml").read_text().splitlines() if not line.startswith("#")]
    read = dict(line.split(": ") for line in lines)
    noisiest = max(WHITE[name] for name in ("gx", "gy", "gz")) * np.pi / 180 / 60
    assert float(read["gyroscope_noise_density"]) == pytest.approx(noisiest, rel=0.05)
    noisiest = 1e-6 * 9.8 * max(WHITE[name] for name in ("ax", "ay", "az"))
    assert float(read["accelerometer_noise_density"]) == pytest.approx(noisiest, rel=0.05)
    walks = [term for one in record.channels if one.kind == "gyro" for term in [one.of(NoiseTerm.RANDOM_WALK)]]
    largest = max(term.value if term.determined else term.upper_limit or 0.0 for term in walks)
    assert float(read["gyroscope_random_walk"]) == pytest.approx(largest * np.pi / 180 / 3600 / 60, rel=1e-6)
    assert float(read["update_rate"]) == pytest.approx(1 / record.channels[0].interval_s)
