"""The site of a campaign in SI: gravity as measured or by WGS 84, and its uncertainty only if it is stated."""

import pytest

from imubayes.campaign.equipment import build_site
from imubayes.campaign.file_schemas import SiteEntry


def test_stated_uncertainty_of_gravity_is_in_micro_g_of_the_site():
    site = build_site(SiteEntry(latitude_deg=45.0, gravity_m_s2=9.8, gravity_uncertainty_ug=2.0))
    assert site.gravity == 9.8
    assert site.gravity_uncertainty == pytest.approx(2e-6 * 9.8)
    assert build_site(SiteEntry(latitude_deg=45.0, gravity_uncertainty_ug=0.0)).gravity_uncertainty == 0.0


@pytest.mark.parametrize("measured", [None, 9.8])
def test_what_is_not_stated_is_unknown(measured):
    """Measured gravity is not taken for exact: an anomaly can be estimated there as well."""
    assert build_site(SiteEntry(latitude_deg=45.0, gravity_m_s2=measured)).gravity_uncertainty is None
