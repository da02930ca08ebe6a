"""The budgets of the reports of all shipped campaigns add up to their posterior variances."""

from pathlib import Path

import pytest
from shipped_budgets import CAMPAIGNS, closing


@pytest.mark.slow
@pytest.mark.parametrize("campaign", CAMPAIGNS)
def test_contributions_add_up_to_the_posterior_variance_of_every_quantity(campaign: str, tmp_path: Path) -> None:
    """Within 2 %, through the result folder that a user has."""
    found = closing(campaign, tmp_path / "result")
    print(found.row)
    assert found.beyond == 0, found
