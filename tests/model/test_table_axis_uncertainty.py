"""The uncertainty of a table's axis, in azimuth and in elevation, becomes the priors of its tilts."""

from dataclasses import replace

import numpy as np
import pytest

from imubayes.campaign import load_campaign
from imubayes.foundations.campaign_data import Table
from imubayes.model.bind import bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from small_campaign import campaign

ARCSEC = np.pi / 648000


def tilt_sd(**stated: float) -> tuple[float, float]:
    """Prior standard deviations of the tilts about x and y of an axis 60 degrees high, arcsec."""
    base = campaign()
    table = replace(base.tables["rate"], elevation=np.pi / 3, axis_uncertainty=20 * ARCSEC)
    changed = replace(table, **{name: value * ARCSEC for name, value in stated.items()})
    effects = (EffectSpec("gyro_bias"), EffectSpec("table_axis_tilt"), EffectSpec("white_noise"))
    model = bind(ModelSpec("m", effects), replace(base, tables=base.tables | {"rate": changed}))
    sd = {parameter.name: parameter.prior_sd for parameter in model.layout.parameters}
    return sd["table_axis_tilt.x[rate]"], sd["table_axis_tilt.y[rate]"]


def test_azimuth_and_elevation_replace_the_uncertainty_of_the_axis():
    assert tilt_sd() == pytest.approx((20, 20))
    assert tilt_sd(azimuth_uncertainty=40.0) == pytest.approx((20, 20))  # 40 arcsec times cos 60 deg
    assert tilt_sd(azimuth_uncertainty=40.0, elevation_uncertainty=8.0) == pytest.approx((8, 20))


@pytest.mark.parametrize("elevation_deg", [-30.0, 0.0, 50.0])
def test_a_tilt_about_x_is_of_the_elevation_and_one_about_y_of_the_azimuth(elevation_deg: float):
    azimuth, elevation, small = 0.7, np.deg2rad(elevation_deg), 1e-6

    def axis(azimuth: float, elevation: float) -> np.ndarray:
        """The axis z, north, east, up."""
        level = np.cos(elevation)
        return np.array([level * np.cos(azimuth), level * np.sin(azimuth), np.sin(elevation)])

    at_zero = Table("t", azimuth, elevation).to_local
    moved = [
        abs(at_zero[:, k] @ _in_local(axis(azimuth + small, elevation) - axis(azimuth, elevation))) for k in (0, 1)
    ]
    raised = [
        abs(at_zero[:, k] @ _in_local(axis(azimuth, elevation + small) - axis(azimuth, elevation))) for k in (0, 1)
    ]
    # The end of z moves along x by a tilt about y, and along y by one about x.
    np.testing.assert_allclose(moved, [small * np.cos(elevation), 0.0], atol=1e-11)
    np.testing.assert_allclose(raised, [0.0, small], atol=1e-11)


def _in_local(north_east_up: np.ndarray) -> np.ndarray:
    """In the axes of the local level of the package, found from its own directions of z."""
    north, east, up = (Table("t", a, e).to_local[:, 2] for a, e in ((0.0, 0.0), (np.pi / 2, 0.0), (0.0, np.pi / 2)))
    return np.stack([north, east, up], axis=1) @ north_east_up


def test_the_keys_of_a_campaign_file(tmp_path):
    (tmp_path / "r.csv").write_text("time_s,table_rate_deg_s,samples,gz\n5,10,100,10000.1\n15,-10,100,-9999.9\n")
    (tmp_path / "campaign.toml").write_text(
        'format = 1\nname = "c"\n[site]\nlatitude_deg = 40\n'
        '[[channel]]\nname = "gz"\nkind = "gyro"\ninput_axis = [0, 0, 1]\noutput_unit = "pulse/s"\nscale = 1000.0\n'
        'per = "deg/s"\nnoise = 1.0\n'
        '[[table]]\nname = "t"\nelevation_deg = 60.0\nazimuth_uncertainty_arcsec = 40.0\n'
        "elevation_uncertainty_arcsec = 8.0\n"
        '[[mounting]]\nname = "up"\npreset = "aligned"\n'
        '[[run]]\nname = "r"\nprocedure = "rate_table"\nfile = "r.csv"\ntable = "t"\nmounting = "up"\n'
    )
    table = load_campaign(tmp_path).tables["t"]
    assert table.tilt_uncertainty == pytest.approx((8 * ARCSEC, 20 * ARCSEC))
    assert table.axis_uncertainty is None
