"""Chosen quantities: densities and pairs are those of the draws; the run that would narrow them is the kernel's."""

import numpy as np
import pytest
from explore_client import settled, wait_for
from explore_page import LACKING, Page
from selenium.webdriver.common.keys import Keys

from imubayes.foundations.errors import InputError
from imubayes_explorer.corner import CornerFacts, _pair, _places, corner_facts

SCALE, RATE = "scale_factor[gz]", "table_rate_error.rate_error[rate]"


def test_a_quantity_has_the_numbers_of_the_summary_and_its_prior_on_one_scale(client, explored, first):
    found = client.json("corner", {"model": first, "names": [SCALE, RATE]})
    scale, rate = found["quantities"]
    own = explored.session.require(first).result.quantities[SCALE]
    assert own.mean is not None
    assert own.sd is not None
    highest = scale["x"][int(np.argmax(scale["posterior"]))]
    assert abs(highest - own.mean) < own.sd
    assert float(scale["estimate"]) == pytest.approx(own.mean, abs=own.sd / 10)
    # The prior of the scale factor is far wider than the posterior; the table's rate has nothing but its prior.
    assert max(scale["prior"]) < 0.1 < max(scale["posterior"]) == 1
    assert max(rate["prior"]) > 0.9
    assert [scale["weak"], rate["weak"]] == [False, True]
    assert rate["written"].startswith("normal(0, ")
    assert scale["written"] == ""
    assert client.ask("corner", {"model": first, "names": ["<nothing>"]})[0] == 400
    assert client.ask("corner", {"model": first, "names": [SCALE] * 7})[0] == 400


def test_a_region_holds_its_share_of_the_draws():
    """A bent distribution: membership is counted from the spans, row by row."""
    rng = np.random.default_rng(4)
    across = rng.normal(3.0, 2.0, 20_000)
    up = 0.1 * (across - 3) ** 2 + rng.normal(0.0, 0.2, across.size)
    places = [_places(each) for each in (across, up)]
    found, rows = _pair(0, 1, [across, up], places), CornerFacts.model_fields["rows"].default
    x, y = ((each - own[0]) / (own[-1] - own[0]) for each, own in zip((across, up), places, strict=True))
    assert found.correlation == pytest.approx(np.corrcoef(across, up)[0, 1], abs=1e-9)
    for region in found.regions:
        held = np.zeros(across.size, dtype=bool)
        for row, low, high in region.spans:
            held |= (np.floor(y * rows) == row) & (x >= low) & (x <= high)
        assert held.mean() == pytest.approx(region.share, abs=0.03)


def test_what_has_no_draws_is_refused(explored, first):
    result = explored.session.require(first).result
    with pytest.raises(InputError, match="no quantity"):
        corner_facts(result, ["scale_factor[gq]"])
    with pytest.raises(InputError, match="no quantity"):
        result.next_runs(["scale_factor[gq]"])


def test_the_run_that_narrows_a_quantity_is_that_of_the_kernel(client, explored, first):
    """It is ranked as a task, and known from then on; a quantity that no run narrows is named."""
    wanted = {"model": first, "names": [RATE, "gyro_bias.bias[gz]"]}
    assert client.ask("runs", wanted)[0] in (200, 202)
    settled(explored)
    found = client.json("runs", wanted)
    best = explored.session.require(first).result.next_runs(wanted["names"])
    assert [row[1] for row in found["table"]["rows"]] == [line.quantity for line in best]
    assert set(found["none_for"]) == set(wanted["names"]) - {line.quantity for line in best}
    assert RATE in found["none_for"]  # a rate table is not distinguished from its own rate by any run on it
    for line in best:
        assert 0 < line.sd_after < 0.9 * line.sd_before


@pytest.mark.skipif(LACKING, reason="Debian's chromium and chromium-driver are not here")
def test_quantities_are_chosen_on_the_page_by_their_names(explored, first):
    """Two names make a corner with one pair, the address holds them, and a click ranks the runs."""
    page = Page(explored.address)
    try:
        page.press("3")
        page.wait("document.querySelector('#tab-panel input[list]')")
        for name in (SCALE, RATE):
            page.run("(document.querySelector('#tab-panel input[list]').focus(), null)")
            page.run("(document.querySelector('#tab-panel input[list]').select(), null)")
            page.press(name, Keys.ENTER)
            page.wait(f"document.querySelector('#corner')?.getAttribute('aria-label').includes('{name}')")
        assert page.view()["quantities"] == [SCALE, RATE]
        assert page.run("document.querySelectorAll('#corner .posterior').length") == 2
        assert page.run("document.querySelectorAll('#corner .wide').length") == 1
        assert page.run("document.querySelector('#corner .weak').textContent") == "0 % from data"
        page.click("#narrow")
        wait_for(lambda: RATE in page.text("#not-narrowed"))
        page.click(f'[data-key="drop-{SCALE}"]')
        page.wait("document.querySelectorAll('#corner .posterior').length === 1")
        page.wait("document.querySelector('#prior')?.value.startsWith('normal(0, ')")
        assert page.complaints() == []
    finally:
        page.close()
