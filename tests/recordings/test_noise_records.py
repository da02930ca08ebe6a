"""`imubayes noise` on logs of many kinds: numbers that hold, a warning, or one error of four parts and status 2."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import polars
import pytest

from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.display.layout import report_text
from imubayes_recordings.display.noise_report import noise_report, priors_text
from imubayes_recordings.noise_analysis.described_band import Cause
from imubayes_recordings.noise_analysis.noise_record import ChannelNoise, StaticNoise, static_noise
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm

WHITE = 0.05  # deg/√h
IN_OUTPUT = WHITE / 60  # deg/s over √Hz
SAMPLES, RATE = 6000, 10.0
_HEAD = """format = 1
name = "bench"

[site]
latitude_deg = 48.0
height_m = 300.0

[unit]
serial = "B1"

[[table]]
name = "plate"
azimuth_deg = 0.0
elevation_deg = 90.0
axis_uncertainty_arcsec = 20.0

[[mounting]]
name = "level"
body_to_table = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
uncertainty_arcmin = 2.0

[[run]]
name = "night"
procedure = "static_record"
file = "night.{suffix}"
table = "plate"
mounting = "level"
start = 2026-11-01T20:00:00Z
temperature_degC = 25.0
"""
_CHANNEL = """
[[channel]]
name = "{name}"
kind = "gyro"
input_axis = [{first}]
output_axis = [{second}]
output_unit = "{unit}"
scale = {scale}
per = "deg/s"
offset = 0.0
noise = {noise}
"""
_AXES = ("1.0, 0.0, 0.0", "0.0, 1.0, 0.0", "0.0, 0.0, 1.0", "1.0, 0.0, 0.0")


def campaign(
    folder: Path,
    columns: Mapping[str, Sequence[float | None] | np.ndarray],
    suffix: str = "csv",
    unit: str = "deg/s",
    scale: float = 1.0,
) -> Path:
    """Write a campaign of one static record; all columns but `time_s` are gyros."""
    names = [name for name in columns if name not in ("time_s", "temperature_degC")]
    head = _HEAD.replace("temperature_degC = 25.0\n", "") if "temperature_degC" in columns else _HEAD
    text = head.format(suffix=suffix)
    for name, first, second in zip(names, _AXES, _AXES[1:], strict=False):
        text += _CHANNEL.format(name=name, first=first, second=second, unit=unit, scale=scale, noise=0.01 * scale)
    (folder / "campaign.toml").write_text(text)
    table = polars.DataFrame(columns)
    if suffix == "csv":
        table.write_csv(folder / "night.csv")
    else:
        table.write_parquet(folder / "night.parquet")
    return folder


def white(samples: int = SAMPLES, rate: float = RATE, seed: int = 1) -> np.ndarray:
    return 0.1 + IN_OUTPUT * np.sqrt(rate) * np.random.default_rng(seed).normal(size=samples)


def time_of(samples: int = SAMPLES, rate: float = RATE) -> np.ndarray:
    return np.arange(samples) / rate


def cells(values: np.ndarray) -> list[float | None]:
    """Return values with empty cells for NaN."""
    return [None if np.isnan(value) else float(value) for value in values]


def noise_of(folder: Path) -> tuple[StaticNoise, str]:
    found = static_noise(load_campaign(folder))
    return found, " ".join(report_text(noise_report(found)).split())


def white_is_right(channel: ChannelNoise) -> bool:
    term = channel.of(NoiseTerm.WHITE)
    return term.value is not None and term.sd is not None and abs(term.value - WHITE) < 3.5 * term.sd


@pytest.mark.parametrize(("rate", "samples"), [(1.0, 3000), (2000.0, 300_000)])
def test_other_sampling_rates(tmp_path: Path, rate: float, samples: int):
    columns = {"time_s": time_of(samples, rate), "g": white(samples, rate)}
    found, text = noise_of(campaign(tmp_path, columns, "parquet"))
    assert white_is_right(found.channels[0])
    assert found.channels[0].interval_s == pytest.approx(1 / rate)
    assert [term.term for term in found.channels[0].terms if term.determined] == [NoiseTerm.WHITE]
    assert text.startswith("g in run 'night': ")  # no warning before the table


def test_gaps_empty_cells_and_jitter(tmp_path: Path):
    random, x = np.random.default_rng(2), white()
    x[random.uniform(size=SAMPLES) < 0.02] = np.nan
    time = time_of() + random.uniform(-0.02, 0.02, SAMPLES)
    kept = np.ones(SAMPLES, dtype=bool)
    kept[2000:2500] = False
    found, _ = noise_of(campaign(tmp_path, {"time_s": time[kept], "g": cells(x[kept]), "h": white(seed=3)[kept]}))
    assert [white_is_right(channel) for channel in found.channels] == [True, True]
    assert found.channels[0].missing == 500 + int(np.isnan(x[kept]).sum())
    assert found.channels[1].missing == 500


def test_integer_counts(tmp_path: Path):
    scale = 36_000.0
    columns = {"time_s": time_of(), "g": np.rint(scale * white()).astype(int)}
    found, text = noise_of(campaign(tmp_path, columns, unit="count", scale=scale))
    assert white_is_right(found.channels[0])
    assert found.channels[0].resolution_in_output_units == 1.0
    assert found.channels[0].rounding_share < 1e-3
    assert "has steps of" not in text


@pytest.mark.parametrize(("step", "said"), [(1.5, "and is taken out of N"), (5.0, "not that of the sensor")])
def test_a_log_coarser_than_its_noise_is_told(tmp_path: Path, step: float, said: str):
    step *= IN_OUTPUT * np.sqrt(RATE)
    found, text = noise_of(campaign(tmp_path, {"time_s": time_of(), "g": np.rint(white() / step) * step}))
    assert found.channels[0].resolution_in_output_units == pytest.approx(step)
    assert "the log has steps of" in text
    assert said in text
    assert white_is_right(found.channels[0]) == (found.channels[0].of(NoiseTerm.WHITE).withheld is None)


def test_pulses_are_counted_angles_and_no_coarse_log(tmp_path: Path):
    pulse = 2.0 / 3600
    angle = np.concatenate([[0.0], np.cumsum(white() / RATE)])
    columns = {"time_s": time_of(), "g": np.diff(np.floor(angle / pulse)).astype(int)}
    found, text = noise_of(campaign(tmp_path, columns, unit="pulse", scale=1 / (RATE * pulse)))
    term = found.channels[0].of(NoiseTerm.QUANTISATION)
    assert term.value == pytest.approx(2.0 / np.sqrt(12), rel=0.1)
    assert "the log has steps of" not in text


@pytest.mark.parametrize(("kind", "time"), [("step", 300), ("turn-on", 20)])
def test_a_change_is_told_and_no_slow_term_beside_it(tmp_path: Path, kind: str, time: float):
    x = white() + {"step": np.where(time_of() > 300, 0.01, 0.0), "turn-on": 0.1 * np.exp(-time_of() / 50)}[kind]
    found, text = noise_of(campaign(tmp_path, {"time_s": time_of(), "g": x}))
    channel = found.channels[0]
    assert channel.sudden_change is not None
    assert abs(channel.sudden_change.time_s - time) < 30
    assert text.startswith("g in run 'night': at ")
    for term in (NoiseTerm.FLICKER, NoiseTerm.RANDOM_WALK, NoiseTerm.RAMP):
        assert channel.of(term).withheld is not None
        assert channel.of(term).upper_limit is None
    assert white_is_right(channel)
    assert "# not determined by this record, and not here: flicker, random_walk" in priors_text(found)


def test_outliers_are_left_out(tmp_path: Path):
    x = white()
    x[[1000, 3000]] += 1.0
    found, text = noise_of(campaign(tmp_path, {"time_s": time_of(), "g": x}))
    assert white_is_right(found.channels[0])
    assert "2 outliers are left out" in text


def test_a_drift_that_the_record_does_not_explain_is_told(tmp_path: Path):
    x = white() + 0.05 * np.sin(time_of() / 150)
    found, text = noise_of(campaign(tmp_path, {"time_s": time_of(), "g": x}))
    assert white_is_right(found.channels[0])
    assert found.channels[0].of(NoiseTerm.FLICKER).withheld is not None
    assert "Give a settled part of the record" in text


def test_a_drift_with_the_recorded_temperature_is_taken_out(tmp_path: Path):
    temperature = 25 + 3 * np.sin(time_of() / 150)
    columns = {"time_s": time_of(), "g": white() + 0.01 * (temperature - 25), "temperature_degC": temperature.round(2)}
    found, text = noise_of(campaign(tmp_path, columns))
    drift = found.channels[0].temperature
    assert drift is not None
    assert abs(drift.slope - 0.01) < 4 * drift.sd
    assert white_is_right(found.channels[0])
    assert not found.channels[0].of(NoiseTerm.FLICKER).determined
    assert "the output follows temperature_degC" in text


def test_a_repeated_channel_beside_one_that_is_not(tmp_path: Path):
    held = np.repeat(white(SAMPLES // 4, RATE / 4), 4)
    found, text = noise_of(campaign(tmp_path, {"time_s": time_of(), "g": held, "h": white(seed=3)}))
    assert [white_is_right(channel) for channel in found.channels] == [True, True]
    assert [channel.samples for channel in found.channels] == [SAMPLES // 4, SAMPLES]
    assert "g in run 'night': each value is repeated 4 times: the output is new every 0.4" in text
    assert "h in run 'night': each value" not in text


def test_a_fit_that_did_not_converge_writes_no_prior(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """The climb is cut short; an earlier file does not stay."""
    monkeypatch.setattr("imubayes_recordings.noise_analysis.likelihood._STEPS", 1)
    folder = campaign(tmp_path, {"time_s": time_of(), "g": white()})
    out = tmp_path / "out"
    out.mkdir()
    (out / "noise-priors.toml").write_text("earlier")
    assert run(["noise", str(folder), "--out", str(out)]) == 1
    assert not (out / "noise-priors.toml").exists()
    found = StaticNoise.model_validate_json((out / "noise.json").read_text())
    assert {term.withheld for term in found.channels[0].terms} == {Cause.CONVERGENCE}
    assert all(term.value is None and term.upper_limit is None for term in found.channels[0].terms)


def test_a_dead_and_an_empty_channel_are_left_out(tmp_path: Path):
    columns = {"time_s": time_of(), "g": white(), "dead": np.full(SAMPLES, 0.25), "empty": [None] * SAMPLES}
    found, text = noise_of(campaign(tmp_path, columns))
    assert [channel.channel for channel in found.channels] == ["g"]
    assert white_is_right(found.channels[0])
    assert [(left.channel, left.reason) for left in found.left_out] == [("dead", "constant"), ("empty", "empty")]
    assert "dead in run 'night' is constant" in text
    assert "empty in run 'night' is without a sample" in text


def irregular() -> np.ndarray:
    return np.sort(np.random.default_rng(4).uniform(0, SAMPLES / RATE, SAMPLES))


@pytest.mark.parametrize(
    ("columns", "what"),
    [
        ({"time_s": time_of(200), "g": white(200)}, "200 samples are too few"),
        ({"time_s": irregular(), "g": white()}, "no constant sampling interval"),
        ({"time_s": time_of(), "g": np.full(SAMPLES, 0.25)}, "no channel varies"),
        ({"time_s": time_of(), "g": cells(np.where(np.arange(SAMPLES) % 5, np.nan, white()))}, "are isolated"),
        ({"time_s": time_of()[::-1], "g": white()}, "the time decreases"),
    ],
)
def test_what_cannot_be_analysed_is_refused(
    tmp_path: Path, columns: dict, what: str, capsys: pytest.CaptureFixture[str]
):
    assert run(["noise", str(campaign(tmp_path, columns))]) == 2
    told = capsys.readouterr().err
    assert what in told
    for part in ("error: ", "  where: ", "  allowed: ", "  do: "):
        assert part in told
    assert "internal error" not in told
