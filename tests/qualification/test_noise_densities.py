"""Noise of a triad in the units of kalibr, from a static record and from a fit; conversions are written down here."""

import math
from dataclasses import replace
from typing import Literal

import numpy as np
import pytest

from imubayes.foundations.errors import InputError
from imubayes_qualification.onboard.losses import of_triad, read_noise, refuse_other_unit
from imubayes_qualification.onboard.record import ThermalPolynomial, TriadConstants
from imubayes_recordings.noise_analysis.noise_record import ChannelNoise, StaticNoise, TermRecord, of_record
from imubayes_recordings.noise_analysis.noise_terms import NoiseTerm
from small_campaign import ACCEL_SCALE, GRAVITY, GYRO_SCALE, campaign

DEGREE, HOUR = math.pi / 180, 3600.0


def term(name: NoiseTerm, unit: str, value: float, determined: bool = True) -> TermRecord:
    known = value if determined else None
    return TermRecord(
        term=name, unit=unit, determined=determined, value=known, sd=known, low=known, high=known,
        upper_limit=None if determined else value, evidence=None, in_output_units=None, maximum_in_output_units=1.0,
        output_per_unit=1.0,
    )  # fmt: skip


def channel(name: str, *terms: TermRecord) -> ChannelNoise:
    return ChannelNoise(
        run="still", channel=name, kind="gyro", samples=1000, missing=0, interval_s=0.01, deviation_unit="deg/h",
        output_per_unit=1.0, output_unit="pulse/s", converged=True, terms=list(terms), correlation_time_s=None,
        correlation_time_sd_s=None, correlated_terms=[], correlation=[], alternatives=[], misfit=[], allan=[],
    )  # fmt: skip


def gyro(name: str, white: float, walk: float, determined: bool) -> ChannelNoise:
    return channel(
        name, term(NoiseTerm.WHITE, "deg/sqrt(h)", white),
        term(NoiseTerm.RANDOM_WALK, "deg/h/sqrt(h)", walk, determined),
    )  # fmt: skip


def static(*channels: ChannelNoise) -> StaticNoise:
    return StaticNoise(campaign="still", channels=list(channels))


def test_a_static_record_gives_the_noisiest_axis_in_si():
    accelerometer = channel(
        "ax", term(NoiseTerm.WHITE, "ug/sqrt(Hz)", 120.0), term(NoiseTerm.RANDOM_WALK, "ug/sqrt(h)", 30.0)
    )
    found = of_record(static(gyro("gx", 0.05, 2.0, True), gyro("gy", 0.06, 1.0, True), accelerometer), campaign())
    # An angle random walk of N °/√h is N·(π/180)/60 rad/√s, which is rad/s/√Hz.
    assert found["gyro"].white == pytest.approx(0.06 * DEGREE / 60)
    assert found["gyro"].walk == pytest.approx(2.0 * DEGREE / HOUR / 60)
    assert not found["gyro"].walk_is_limit
    assert found["accelerometer"].white == pytest.approx(120e-6 * GRAVITY)
    assert found["accelerometer"].walk == pytest.approx(30e-6 * GRAVITY / 60)


def test_a_walk_that_is_not_determined_is_an_upper_limit():
    found = of_record(static(gyro("gx", 0.05, 2.0, False), gyro("gy", 0.06, 1.0, True)), campaign())
    assert found["gyro"].walk == pytest.approx(2.0 * DEGREE / HOUR / 60)
    assert found["gyro"].walk_is_limit
    assert "accelerometer" not in found


def triad(kind: Literal["gyro", "accelerometer"], scale: float, noise: tuple[float, ...]) -> TriadConstants:
    names = tuple(f"{kind[0]}{axis}" for axis in "xyz")
    none = ThermalPolynomial(terms=(), coefficients=((), (), ()))
    return TriadConstants(
        kind=kind, unit="rad/s", channels=names, output_units=("pulse/s",) * 3, nominal_scale=(scale, -scale, scale),
        nominal_offset=(0.0,) * 3, matrix=((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)), bias=none, gain=none,
        g_sensitivity=None, input_range=1.0, error_left=0.0, sample_noise=noise, run_offset=(0.0,) * 3,
    )  # fmt: skip


def test_the_noise_of_a_sample_is_a_density_at_its_rate():
    """White noise of standard deviation σ at f samples a second has the one-sided density σ/√f of kalibr."""
    gyros = triad("gyro", GYRO_SCALE, (1e-4, 3e-4, 2e-4))
    found = of_triad(gyros, {"gy": 6.0}, 100.0)
    assert found.white == pytest.approx(3e-5)
    assert found.walk == pytest.approx(6.0 / GYRO_SCALE / 60)
    assert of_triad(gyros, {"all": 3.0, "gx": 6.0}, 100.0).walk == found.walk
    still = of_triad(triad("accelerometer", ACCEL_SCALE, (0.02, 0.01, 0.0)), {"gy": 6.0}, None)
    assert (still.white, still.walk) == (None, None)
    samples = 3e-4 * np.random.default_rng(2).standard_normal(200_000)
    # The mean of one second, 100 samples, has the standard deviation density · 1/√(1 s).
    assert found.white == pytest.approx(samples.reshape(-1, 100).mean(axis=1).std(), rel=0.05)


def test_a_file_that_is_no_noise_record_is_refused_in_four_parts(tmp_path):
    for text, fault in ((None, "no such file"), ("{}", "not a noise record")):
        file = tmp_path / "noise.json"
        if text is not None:
            file.write_text(text)
        with pytest.raises(InputError) as caught:
            read_noise(file)
        (issue,) = caught.value.issues
        assert fault in issue.what
        assert issue.where == str(file)
        assert "noise.json" in issue.allowed
        assert issue.remedy
    file.write_text(static(gyro("gx", 0.05, 2.0, True)).model_dump_json())
    assert read_noise(tmp_path) == read_noise(file)


@pytest.mark.parametrize(
    ("of_record", "of_fit", "refused"),
    [
        (("still", "U7"), ("small", "U7"), False),
        (("still", "U7"), ("small", "U8"), True),
        (("still", "U7"), ("still", ""), True),
        (("still", ""), ("small", ""), True),
        (("small", ""), ("small", ""), False),
    ],
)
def test_the_noise_of_another_unit_is_refused(of_record, of_fit, refused):
    record = static(gyro("gx", 0.05, 2.0, True)).model_copy(
        update=dict(zip(("campaign", "serial"), of_record, strict=True))
    )
    unit = replace(campaign(), name=of_fit[0], serial=of_fit[1])
    if not refused:
        refuse_other_unit(record, unit, "noise.json")
        return
    with pytest.raises(InputError) as caught:
        refuse_other_unit(record, unit, "noise.json")
    (issue,) = caught.value.issues
    assert "noise record is from" in issue.what
    assert "--noise-of-another-unit" in issue.remedy
