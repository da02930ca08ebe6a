"""The walk on the shipped campaign in Debian's Chromium, from opening to the exported model, by mouse and by keys."""

import base64
import json
import threading
from urllib.parse import quote
from xml.etree import ElementTree

import pytest
from explore_client import settled
from explore_page import LACKING, Page
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from imubayes_explorer.worker import TaskOutcome

pytestmark = pytest.mark.skipif(LACKING, reason="Debian's chromium and chromium-driver are not here")
HIDDEN = "gyro_scale_asymmetry"


@pytest.fixture(scope="module")
def page(explored):
    found = Page(explored.address)
    yield found
    found.close()


@pytest.fixture
def fresh(page, explored, first, client):
    """The page on the first model, nothing selected or ticked."""
    client.json("select", {"model": first})
    page.run("(history.replaceState(null, '', location.pathname), null)")
    page.driver.refresh()
    page.open(explored.address)
    page.wait(f"JSON.parse(decodeURIComponent(location.hash.slice(1)) || '{{}}').model === {json.dumps(first)}")
    yield page
    assert page.complaints() == []


def test_the_first_page_tells_the_verdict_and_where_the_model_fails(fresh, explored):
    assert HIDDEN in fresh.text("#sentence")
    assert fresh.run("document.querySelectorAll('#verdict .kind').length") == 5
    assert fresh.run("document.querySelectorAll('.cell').length") == 42
    assert HIDDEN in fresh.text("#causes .cause label")
    # The channel that fails worst is shown against what its residual depends on.
    assert fresh.view()["channel"] == "gz"
    assert fresh.view()["x"] == "rate_i"


def test_a_brush_of_residuals_ranks_their_causes(fresh):
    over = fresh.driver.find_element(By.CSS_SELECTOR, "#residuals .u-over")
    width, height = over.rect["width"], over.rect["height"]
    drag = ActionChains(fresh.driver).move_to_element_with_offset(over, int(-0.49 * width), int(-0.47 * height))
    drag.click_and_hold().move_by_offset(int(0.35 * width), int(0.5 * height)).release().perform()
    fresh.wait("document.querySelector('#selection-sentence')")
    brush = fresh.view()["brushes"][0]
    assert brush["x"] == "rate_i"
    assert brush["x_low"] < -100
    assert brush["y_low"] > -1
    assert HIDDEN in fresh.text("#selection-sentence")
    assert "χ²" in fresh.text("#selection-sentence")
    # The address holds the view: the same selection stands there after a reload.
    said = fresh.text("#selection-sentence")
    fresh.driver.refresh()
    fresh.wait("document.querySelector('#selection-sentence')")
    assert fresh.text("#selection-sentence") == said


def test_a_cell_of_the_map_selects_and_a_cause_is_previewed(fresh):
    before = float(fresh.text('[data-key="cell-rate-z-up-gz"]'))
    fresh.click('[data-key="cell-rate-z-up-gz"]')
    fresh.wait("document.querySelector('#selection-sentence')?.textContent.startsWith('12 readings')")
    fresh.click(f'[id="tick-{HIDDEN}"]')
    fresh.wait("document.querySelector('#preview-sentence')")
    assert "Δχ² 1030" in fresh.text("#preview-sentence")
    fresh.wait("document.querySelectorAll('.cell.previewed').length === 42")
    assert float(fresh.text('[data-key="cell-rate-z-up-gz"]')) < before / 5
    fresh.click("#tab-estimates")
    fresh.wait("document.querySelector('#tab-panel').textContent.includes('gyro_bias.bias[gz]')")
    assert "imubayes add" in fresh.text("#causes pre")


def test_the_walk_by_keys_alone(fresh, explored, first, client):
    """Select, tick, add, see that nothing is missing, go back."""
    fresh.press("m")
    fresh.press(Keys.ARROW_DOWN, Keys.ARROW_RIGHT, Keys.ENTER)
    fresh.wait("document.querySelector('#selection-sentence')")
    fresh.press(Keys.ESCAPE)
    fresh.wait("!document.querySelector('#selection-sentence')")
    fresh.press("r")
    fresh.press(Keys.ARROW_RIGHT, Keys.ARROW_RIGHT)
    fresh.wait("document.querySelector('#selection-sentence')")
    fresh.press(Keys.ESCAPE)
    fresh.press("c")
    fresh.wait(f"document.activeElement.id === 'tick-{HIDDEN}'")
    fresh.press(Keys.SPACE)
    fresh.wait("document.querySelector('#preview-sentence') && !document.querySelector('#accept').disabled")
    fresh.press(Keys.ENTER)
    # New residuals, χ² and the drop that was reached are there while the fit is made.
    fresh.wait("document.querySelector('#refit-sentence')?.textContent.includes('observed 103')")
    fresh.wait("document.querySelector('#residual-title').textContent.startsWith('residual of the refit')")
    assert float(fresh.text('[data-key="cell-rate-z-up-gz"]')) < 2
    fresh.wait("document.querySelector('#cancel')")
    fresh.driver.refresh()  # the work goes on
    fresh.wait("document.querySelector('#sentence')?.textContent.includes('explains the data')")
    assert "predicted 103" in fresh.text("#notice")
    made = fresh.view()["model"]
    assert made != first
    fresh.press("1")
    fresh.wait("document.querySelector('#tab-panel').textContent.includes('+ gyro_scale_asymmetry')")
    fresh.press("4")
    fresh.wait("document.querySelector('#commands')?.textContent.includes('imubayes add gyro_scale_asymmetry')")
    fresh.press("u")
    fresh.wait(f"document.querySelector('#sentence')?.textContent.startsWith('{HIDDEN} is missing')")
    assert fresh.view()["model"] == first
    tree = {line["id"]: line for line in client.json("state")["tree"]}
    assert tree[first]["selected"]
    assert not tree[made]["selected"]


def test_two_windows_agree(fresh, explored, first, client):
    other = Page(explored.address)
    try:
        client.json("note", {"model": first, "name": '<b>first</b> & "only"', "note": "<script>alert(1)</script>"})
        for window in (fresh, other):
            window.press("1")
            window.wait("document.querySelector('#tab-panel').textContent.includes('<b>first</b> & \"only\"')")
            assert window.run("document.querySelectorAll('#tab-panel b, #tab-panel script').length") == 0
        fresh.click(f'[id="tick-{HIDDEN}"]')
        fresh.click("#accept")
        other.wait("document.querySelector('#cancel')")
        other.press("x")
        for window in (fresh, other):
            window.wait("document.querySelector('#notice').textContent.includes('was cancelled; nothing was written')")
        settled(explored)
        assert other.complaints() == []
    finally:
        client.json("note", {"model": first})
        other.close()


def test_the_panels_are_saved_as_pictures(fresh):
    """What is downloaded is caught: SVG with every point and both labels, which is well formed, and PNG."""
    fresh.driver.execute_script(
        "window.caught = []; const made = URL.createObjectURL; HTMLAnchorElement.prototype.click = () => {};"
        "URL.createObjectURL = (blob) => { blob.arrayBuffer().then((content) => caught.push([blob.type,"
        "btoa([...new Uint8Array(content)].map((each) => String.fromCharCode(each)).join(''))])); return made(blob); };"
    )
    fresh.press("g", "G")
    fresh.wait("caught.length === 2")
    pictures = {kind: base64.b64decode(content) for kind, content in fresh.run("caught")}
    svg = ElementTree.fromstring(pictures["image/svg+xml"])
    paths, words = ([each for each in svg.iter() if each.tag.endswith(name)] for name in ("}path", "}text"))
    # A filled circle is two arcs; the seventh run has triangles.
    arcs = sum(each.attrib["d"].count("a") for each in paths) // 2
    shown = fresh.run(
        "Number(document.querySelector('#residuals').getAttribute('aria-label').match(/(\\d+) readings/)[1])"
    )
    closed = sum(each.attrib["d"].count("Z") for each in paths)
    assert arcs + closed >= 2 * shown > 100
    assert {"rate along the input axis / deg/s", "residual / known noise", "gz / pulse/s"} <= {
        each.text for each in words
    }
    assert pictures["image/png"].startswith(b"\x89PNG")
    assert len(pictures["image/png"]) > 5000
    fresh.driver.refresh()


def test_help_tour_theme_and_what_is_known(fresh):
    fresh.press("?")
    fresh.wait("document.querySelector('#dialog').open")
    assert fresh.run("document.querySelectorAll('#dialog tr').length") >= 15
    fresh.press(Keys.ESCAPE)
    fresh.press("t")
    for step in range(1, 10):
        fresh.wait(f"document.querySelector('#tour-title').textContent.startsWith('{step} of 9')")
        fresh.press(Keys.ENTER)
    fresh.wait("!document.querySelector('#tour')")
    before = fresh.run("getComputedStyle(document.body).backgroundColor")
    fresh.press("d")
    assert fresh.run("getComputedStyle(document.body).backgroundColor") != before
    fresh.press("d")
    fresh.press("3")
    fresh.wait("document.querySelector('#tab-panel').textContent.includes('Weakly determined combinations')")
    field = fresh.driver.find_element(By.CSS_SELECTOR, "#tab-panel input[list]")
    field.send_keys("scale_factor[gz]", Keys.ENTER)
    fresh.wait("document.querySelector('#corner .posterior')")
    fresh.press(Keys.ESCAPE)


def test_the_tour_stands_beside_its_panel_and_waits_for_a_brush(fresh):
    """Each step leaves its panel free; a selection and a preview of one's own take it on, and the focus stays there."""
    overlap = (
        "((one, other) => Math.min(one.right, other.right) > Math.max(one.left, other.left) + 1"
        " && Math.min(one.bottom, other.bottom) > Math.max(one.top, other.top) + 1)"
        "(document.querySelector('#tour').getBoundingClientRect(),"
        " document.querySelector('.toured').getBoundingClientRect())"
    )
    fresh.press("t")
    for step in range(1, 4):
        fresh.wait(f"document.querySelector('#tour-title').textContent.startsWith('{step} of 9')")
        assert not fresh.run(overlap)
        fresh.press(Keys.ENTER)
    fresh.wait("document.querySelector('#tour-title').textContent.startsWith('4 of 9')")
    assert fresh.text("#tour-next") == "skip"
    fresh.click('[data-key="cell-rate-z-up-gz"]')
    fresh.wait("document.querySelector('#tour-title').textContent.startsWith('5 of 9')")
    assert fresh.run("document.activeElement.dataset.key") == "cell-rate-z-up-gz"
    fresh.click("#tour-next")
    fresh.wait("document.querySelector('#tour-title').textContent.startsWith('6 of 9')")
    assert not fresh.run(overlap)
    fresh.click(f'[id="tick-{HIDDEN}"]')
    fresh.wait("document.querySelector('#tour-title').textContent.startsWith('7 of 9')")
    fresh.run("(document.querySelector('#tour-next').focus(), null)")
    fresh.press(Keys.ESCAPE)
    fresh.wait("!document.querySelector('#tour') && !document.querySelector('.toured')")
    assert fresh.view()["ticked"] == [HIDDEN]  # Escape ended the tour alone


def test_what_is_typed_and_folded_stays_while_the_worker_works(fresh, explored, first):
    """A step of the worker draws its own line anew; a change of the tree, or of locks, not what has no part in it."""
    fresh.press("3")
    fresh.wait("document.querySelectorAll('#tab-panel details').length > 3")
    fresh.click("#tab-panel details:last-of-type summary")
    field = fresh.driver.find_element(By.CSS_SELECTOR, "#tab-panel input[list]")
    field.send_keys("scale_fac")
    fresh.run("(document.querySelector('#causes').firstChild.dataset.same = 'yes', null)")
    go = threading.Event()

    def work(tell):
        for step in range(400):
            tell(f"step {step}")
            if go.wait(0.05):
                break
        return TaskOutcome("", ("worked",))

    explored.session.worker.submit("change", "a long task", first, work)
    fresh.wait(
        "document.querySelector('#late-sentence')?.textContent === 'The residuals of this change come with its fit.'"
    )
    fresh.wait("/step [2-9]/.test(document.querySelector('#notice').textContent)")
    fresh.run("(document.querySelector('#causes').firstChild.dataset.same = 'yes', null)")  # after busy was told
    seen = fresh.text("#notice")
    fresh.wait(f"document.querySelector('#notice').textContent !== {json.dumps(seen)}")
    assert fresh.run("document.querySelector('#causes').firstChild.dataset.same") == "yes"
    go.set()
    fresh.wait("document.querySelector('#notice').textContent.includes('worked')")
    assert field.get_property("value") == "scale_fac"  # the element itself, where it was
    assert fresh.run("document.activeElement.dataset.key") == "quantity"
    assert fresh.run("[...document.querySelectorAll('#tab-panel details')].at(-1).open")
    # The name is completed, which draws the panel anew: what was unfolded stays so.
    field.send_keys("tor[gz]", Keys.ENTER)
    fresh.wait("document.querySelector('#corner .posterior')")
    assert fresh.run("[...document.querySelectorAll('#tab-panel details')].at(-1).open")


def test_an_address_of_nonsense_opens_the_page(fresh, explored):
    nonsense = quote(
        json.dumps({"model": "x" * 40, "channel": 7, "brushes": "all", "tab": "<i>", "ticked": ["nothing"]})
    )
    fresh.driver.get("about:blank")
    fresh.open(f"{explored.address}#{nonsense}")
    assert HIDDEN in fresh.text("#sentence")


def test_sensor_axes_are_turned_by_mouse_and_by_keys(fresh):
    """The picture says what it shows, its exaggeration included, and a table says it in numbers."""
    fresh.press("3")
    fresh.wait("document.querySelectorAll('#geometry .cone').length === 6")
    label = fresh.run("document.querySelector('#geometry').getAttribute('aria-label')")
    assert "gx is tilted by" in label
    assert "drawn 200 times as large" in label
    assert fresh.run("document.querySelectorAll('.geometry-figure tbody tr').length") == 6
    fresh.run("(document.querySelector('#geometry').scrollIntoView({ block: 'center' }), null)")
    drawn = "document.querySelector('#geometry .fitted').getAttribute('d')"
    found = [fresh.run(drawn)]
    picture = fresh.driver.find_element(By.ID, "geometry")
    ActionChains(fresh.driver).click_and_hold(picture).move_by_offset(40, 10).release().perform()
    found.append(fresh.run(drawn))
    fresh.run("(document.querySelector('#geometry').focus(), null)")
    for keys in ((Keys.ARROW_LEFT,), ("+",), ("0",)):
        fresh.press(*keys)
        found.append(fresh.run(drawn))
    assert len(set(found)) == 4
    assert found[-1] == found[0]
    fresh.run("(document.querySelector('#geometry-frame').value = 'pyramid', null)")
    fresh.run("(document.querySelector('#geometry-frame').dispatchEvent(new Event('change')), null)")
    assert "mounting pyramid" in fresh.run("document.querySelector('#geometry').getAttribute('aria-label')")


def test_five_causes_are_in_sight_whatever_is_open(fresh):
    """Sensor axes below, a selection above, a preview beneath; what else may explain the selection stands apart."""
    whole = (
        "[...document.querySelectorAll('#causes .cause:not(.other)')].filter((each) => each.getBoundingClientRect()"
        ".bottom <= document.querySelector('#causes .accept').getBoundingClientRect().top + 1).length"
    )
    fresh.run("(document.querySelector('#notice [aria-label=dismiss]')?.click(), null)")  # of a change before
    fresh.press("3")
    fresh.wait("document.querySelector('#geometry')")
    assert fresh.run(whole) >= 5
    fresh.click(f'[id="tick-{HIDDEN}"]')
    fresh.click('[data-key="cell-rate-x-up-gx"]')
    fresh.wait("document.querySelector('#selection-sentence') && document.querySelector('#preview-sentence')")
    assert fresh.run("document.querySelectorAll('#causes .cause.other').length") >= 2
    assert fresh.run(whole) >= 5
    assert fresh.run("document.querySelector('#causes .accept').getBoundingClientRect().bottom <= innerHeight")


def test_a_shape_is_drawn_by_mouse_and_by_keys(fresh):
    fresh.click("#draw")
    sheet = fresh.driver.find_element(By.ID, "drawing")
    wide, high = sheet.rect["width"], sheet.rect["height"]
    drag = ActionChains(fresh.driver, duration=50)
    drag.move_to_element_with_offset(sheet, int(-0.45 * wide), int(-0.4 * high)).click_and_hold()
    for way in (1, 1, 1, 1, -1, -1, -1, -1):
        drag.move_by_offset(int(wide / 9), int(way * high / 6))
    drag.release().perform()
    fresh.wait("document.querySelector('#dialog[open] #add-formula')")
    assert "Drawn: |Ω_i|" in fresh.text("#dialog")
    fresh.press(Keys.ESCAPE)
    fresh.press("w", Keys.SPACE, *[Keys.ARROW_RIGHT] * 19, *[Keys.ARROW_UP] * 8, Keys.SPACE, Keys.ENTER)
    fresh.wait("document.querySelector('#dialog[open] #add-formula')")
    assert "Drawn: Ω_i" in fresh.text("#dialog")
    fresh.press(Keys.ESCAPE)
    fresh.press("w", Keys.ESCAPE)
    assert not fresh.run("document.querySelector('#drawing')")
