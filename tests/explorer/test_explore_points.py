"""Pointing, clicking, zooming and folding on the page, by mouse, touch and keys, from 390 to 1920 px."""

import json
import re
from urllib.parse import quote

import pytest
from explore_page import LACKING, Page
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

pytestmark = pytest.mark.skipif(LACKING, reason="Debian's chromium and chromium-driver are not here")
HIDDEN = "gyro_scale_asymmetry"
SIZES = {"phone": (390, 844), "laptop": (1280, 800), "desk": (1920, 1080)}


@pytest.fixture(scope="module")
def page(explored, first):
    found = Page(explored.address)
    yield found
    found.close()


@pytest.fixture
def fresh(page, explored, first):
    page.driver.get("about:blank")
    page.open(f"{explored.address}#{json.dumps({'model': first, 'channel': 'gz', 'x': 'rate_i'})}")
    page.wait("document.querySelector('#causes .cause')")
    yield page
    assert page.complaints() == []


def show_theme(page, theme: str) -> None:
    switch = "document.querySelector('#open-theme').click()"
    page.run(f"(document.documentElement.dataset.theme !== '{theme}' && {switch}, null)")


def place_of_worst(page) -> tuple[int, int, dict]:
    """The place on the residual panel of the reading farthest off, by the picture that is drawn, from its middle."""
    drawn = page.run(
        "(() => { const over = document.querySelector('#residuals .u-over').getBoundingClientRect();"
        "return { width: over.width, height: over.height, left: over.left, top: over.top }; })()"
    )
    # gz at −300 deg/s in rate-z-up is the highest, at the left edge of the panel: it is looked for by pointing.
    return round(-0.47 * drawn["width"]), round(-0.41 * drawn["height"]), drawn


def pointed(page, right: int, down: int) -> str:
    over = page.driver.find_element(By.CSS_SELECTOR, "#residuals .u-over")
    ActionChains(page.driver).move_to_element_with_offset(over, right, down).perform()
    page.wait("!document.querySelector('#reading')?.hidden")
    return page.text("#reading")


def test_pointing_at_a_reading_says_what_it_is_and_a_click_selects_it(fresh):
    right, down, _ = place_of_worst(fresh)
    said = pointed(fresh, right, down)
    assert "rate-z-up, row " in said
    for words in (" ± ", "pulse/s", "table rate", "-300".replace("-", "−"), "over known noise"):
        assert words in said, (words, said)
    over = fresh.driver.find_element(By.CSS_SELECTOR, "#residuals .u-over")
    ActionChains(fresh.driver).move_to_element_with_offset(over, right, down).click().perform()
    fresh.wait("document.querySelector('#selection-sentence')?.textContent.startsWith('1 reading: ')")
    [brush] = fresh.view()["brushes"]
    assert brush["runs"] == ["rate-z-up"]
    assert len(brush["rows"]) == 1
    # If there is no reading a click selects nothing.
    ActionChains(fresh.driver).move_to_element_with_offset(over, 0, down).click().perform()
    assert fresh.view()["brushes"] == [brush]


def test_the_wheel_zooms_about_the_pointer_and_back(fresh):
    over = fresh.driver.find_element(By.CSS_SELECTOR, "#residuals .u-over")
    ActionChains(fresh.driver).move_to_element(over).perform()
    turn = (
        "document.querySelector('#residuals .u-over').dispatchEvent(new WheelEvent('wheel',"
        "{{ deltaY: {}, bubbles: true, cancelable: true, clientX: {}, clientY: {} }}))"
    )
    box = fresh.run("document.querySelector('#residuals .u-over').getBoundingClientRect().toJSON()")
    at = box["left"] + 0.75 * box["width"], box["top"] + box["height"] / 2
    for _ in range(3):
        fresh.run(turn.format(-200, *at))
    low, high = fresh.view()["between"]
    assert high - low < 150
    assert low < 150 < high
    fresh.wait(
        "/Residuals of gz: (\\d+)/.exec(document.querySelector('#residuals').getAttribute('aria-label'))[1] < 120"
    )
    for _ in range(8):
        fresh.run(turn.format(300, *at))
    fresh.wait("!JSON.parse(decodeURIComponent(location.hash.slice(1))).between")


def test_a_finger_selects_as_the_mouse_does(fresh):
    """A drag of a touch: a rectangle; a tap: one reading."""
    right, down, box = place_of_worst(fresh)
    middle = box["left"] + box["width"] / 2, box["top"] + box["height"] / 2

    def touch(kind, *points):
        at = [{"x": x, "y": y} for x, y in points]
        fresh.driver.execute_cdp_cmd("Input.dispatchTouchEvent", {"type": kind, "touchPoints": at})

    fresh.driver.execute_cdp_cmd("Emulation.setTouchEmulationEnabled", {"enabled": True})
    start = box["left"] + 3, box["top"] + 4
    touch("touchStart", start)
    for share in (0.2, 0.5, 1.0):
        touch("touchMove", (start[0] + share * 0.35 * box["width"], start[1] + share * 0.5 * box["height"]))
    touch("touchEnd")
    fresh.wait("document.querySelector('#selection-sentence')")
    [brush] = fresh.view()["brushes"]
    assert (brush["x"], brush["y"]) == ("rate_i", "known")
    assert brush["x_low"] < -250
    touch("touchStart", (middle[0] + right, middle[1] + down))
    touch("touchEnd")
    fresh.wait("document.querySelector('#selection-sentence')?.textContent.startsWith('1 reading: ')")


def test_a_click_in_the_legend_shows_its_runs_alone(fresh):
    fresh.click('[data-key="legend-rate-z-up"]')
    fresh.wait("/Residuals of gz: 12 /.test(document.querySelector('#residuals').getAttribute('aria-label'))")
    assert fresh.view()["only"] == ["rate-z-up"]
    fresh.click('[data-key="legend-rate-z-up"]')
    fresh.wait("/Residuals of gz: 120 /.test(document.querySelector('#residuals').getAttribute('aria-label'))")
    shapes = fresh.run("[...document.querySelectorAll('#legend path')].map((each) => each.getAttribute('d'))")
    assert len(set(shapes[:6])) == 6  # a shape with every hue


def test_the_verdict_is_folded_and_stays_so(fresh):
    fresh.press("h")
    fresh.wait("!document.querySelector('#sentence')")
    assert fresh.run("document.querySelectorAll('#verdict .kind').length") == 0
    fresh.driver.refresh()
    fresh.wait("document.querySelector('#causes .cause')")
    assert not fresh.run("document.querySelector('#sentence')")
    fresh.click("#fold")
    fresh.wait("document.querySelector('#sentence')")


@pytest.mark.parametrize("size", SIZES)
def test_no_statement_is_cut(fresh, size):
    """Every element with text shows all of it, and the page is no wider than the window."""
    width, height = SIZES[size]
    fresh.driver.execute_cdp_cmd(
        "Emulation.setDeviceMetricsOverride",
        {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False},
    )
    try:
        for tab in ("1", "2"):
            fresh.press(tab)
            fresh.wait("document.querySelector('#tab-panel tbody tr')")
            cut = fresh.run(
                "[...document.querySelectorAll('#top *, #causes *, #notice *, #tab-panel *')].filter((each) =>"
                "!['TABLE', 'TBODY', 'INPUT', 'SELECT', 'PRE', 'I', 'B'].includes(each.tagName) && each.textContent"
                "&& getComputedStyle(each).overflow !== 'visible' && !each.classList.contains('bar')"
                "&& getComputedStyle(each).position !== 'absolute'"
                "&& (each.scrollWidth > each.clientWidth + 1 || each.scrollHeight > each.clientHeight + 1))"
                ".map((each) => each.outerHTML.slice(0, 120))"
            )
            assert cut == []
            assert fresh.run("document.documentElement.scrollWidth") <= width
            if width < 641:
                beyond = fresh.run(
                    "[...document.querySelectorAll('.panel, #sentence, .kind, #tab-panel td, .cause')].filter((each) =>"
                    f"each.getBoundingClientRect().right > {width}).length"
                )
                assert beyond == 0
                assert fresh.run("new Set([...document.querySelectorAll('.panel')].map((each) =>"
                                 "Math.round(each.getBoundingClientRect().left))).size") == 1  # fmt: skip
    finally:
        fresh.driver.execute_cdp_cmd(
            "Emulation.setDeviceMetricsOverride",
            {"width": 1280, "height": 800, "deviceScaleFactor": 1, "mobile": False},
        )


@pytest.mark.parametrize("theme", ["light", "dark"])
def test_cells_are_darker_or_lighter_with_chi2_up_to_the_worst(fresh, theme):
    """From the ground of the theme to its opposite, on a logarithmic scale that ends at the worst cell."""
    fresh.run(
        f"(document.documentElement.dataset.theme !== '{theme}' && document.querySelector('#open-theme').click(), null)"
    )
    cells = fresh.run(
        "[...document.querySelectorAll('.cell')].map((each) => [Number(each.textContent),"
        "getComputedStyle(each).backgroundColor.match(/[0-9.]+/g).map(Number)])"
    )
    light = {}
    for ratio, rgb in cells:
        light.setdefault(ratio, []).append(sum(p * c for p, c in zip((0.2126, 0.7152, 0.0722), rgb[:3], strict=True)))
    means = [sum(light[ratio]) / len(light[ratio]) for ratio in sorted(light) if ratio >= 1]
    assert means == sorted(means, reverse=theme == "light")
    ground = 250 if theme == "light" else 35
    assert abs(means[0] - ground) < 25
    assert abs(means[-1] - means[0]) > 180
    assert fresh.text("#scale span:last-of-type") == "46"
    fresh.run(
        "(document.documentElement.dataset.theme === 'dark' && document.querySelector('#open-theme').click(), null)"
    )


def test_ticks_have_the_digits_that_tell_them_apart(fresh):
    found = fresh.driver.execute_async_script(
        "const done = arguments[0]; import('./page/dom.js').then(({ ticks }) => done(["
        "ticks([0.0055, 0.00575, 0.006, 0.00625]), ticks([-2.5, 0, 2.5]), ticks([0, 2000000, 4000000]),"
        "ticks([1000, 1000.5]),"
        "ticks([-0.00002, 0, 0.00002])]))"
    )
    assert found == [
        ["0.00550", "0.00575", "0.00600", "0.00625"], ["−2.5", "0.0", "2.5"], ["0", "2e6", "4e6"], ["1000.0", "1000.5"],
        ["−2e-5", "0", "2e-5"],
    ]  # fmt: skip


def ticks_of_panels(page) -> list[list[str]]:
    """The labels of both axes of every panel, as the SVG of the panels has them."""
    return page.driver.execute_async_script(
        "const done = arguments[0]; import('./page/panels.js').then(async ({ picture }) => {"
        "const svg = new DOMParser().parseFromString(await (await picture('svg')).text(), 'image/svg+xml');"
        "done([...svg.querySelectorAll('g:has(> text)')].map((group) =>"
        "[...group.querySelectorAll(':scope > text')].map((each) => each.textContent))); })"
    )


def test_residuals_with_a_preview_stand_beside_those_of_the_model_on_the_same_axes(fresh):
    fresh.click(f'[id="tick-{HIDDEN}"]')
    fresh.wait("document.querySelector('#preview-sentence')")
    fresh.press("b")
    fresh.wait(f"document.querySelector('#beside-title').textContent === 'residual with {HIDDEN}'")
    boxes = [fresh.run(f"document.querySelector('#{each}').getBoundingClientRect().toJSON()")
             for each in ("residuals", "beside")]  # fmt: skip
    assert boxes[0]["right"] <= boxes[1]["left"]
    assert boxes[0]["top"] == boxes[1]["top"]
    assert abs(boxes[0]["width"] - boxes[1]["width"]) < 2
    _, model, preview = sorted(ticks_of_panels(fresh), key=lambda each: "residual / known noise" in each)
    assert model == preview
    assert len(model) > 6
    fresh.press("b")
    fresh.wait("document.querySelector('#beside').hidden")


def test_all_estimates_are_listed_with_and_without_a_preview(fresh):
    fresh.press("2")
    fresh.wait("document.querySelectorAll('#calibration tbody tr').length > 40")
    head = fresh.run("[...document.querySelectorAll('#calibration th')].map((each) => each.textContent)")
    assert head == ["name", "estimate", "sd", "unit", "from data"]
    count = fresh.run("document.querySelectorAll('#calibration tbody tr').length")
    fresh.click(f'[id="tick-{HIDDEN}"]')
    fresh.wait("document.querySelectorAll('#calibration th').length === 7")
    assert fresh.run("document.querySelectorAll('#calibration tbody tr').length") == count
    assert fresh.run("document.querySelector('#calibration tbody tr [data-label=shift]').textContent").endswith(" sd")
    fresh.press(Keys.ESCAPE)


def test_another_result_is_told_and_shown_when_asked(fresh):
    """The state says that the folder holds another one: the page reports it, and asks for it on a click."""
    fresh.run("(window.asked = [], null)")
    # It is not opened anew here, which takes as long as its diagnosis: test_explore_opening does.
    fresh.run(
        "(window.held = fetch, window.fetch = (name, ...all) => { asked.push(name);"
        "return name === 'reload' ? held('state') : held(name, ...all); }, null)"
    )
    told = (
        "import('./page/state.js').then(({ hear, told }) => hear({ ...told.session,"
        "opened: told.session.opened.map((each) => ({ ...each, replaced: true })) }))"
    )
    fresh.run(f"({told}, null)")
    fresh.wait("document.querySelector('#replaced')")
    assert "no longer contains the result that is shown" in fresh.text("#replaced")
    fresh.click("#reload")
    fresh.wait("asked.includes('reload') && !document.querySelector('#replaced')")


def test_causes_come_one_by_one_while_they_are_weighed(fresh):
    """The state of a search at work names the causes so far; what follows is added, what is certain stays on top."""

    def weighing(hypotheses: int, **found: float) -> None:
        inclusion = [{"effect": e, "channels": [], "probability": p} for e, p in found.items()]
        so_far = json.dumps({"hypotheses": hypotheses, "inclusion": inclusion})
        facts = "facts: { ...told.facts, stage: 'read', causes: [] }"
        fresh.run(f"(import('./page/state.js').then(({{ tell, told }}) => tell({{ {facts}, soFar: {so_far} }})), null)")

    weighing(2, gyro_scale_asymmetry=0.9991)
    fresh.wait("document.querySelectorAll('#so-far .cause').length === 1")
    assert "2 explanations weighed so far" in fresh.text("#so-far")
    assert not fresh.run("document.querySelector('#so-far .tick')")
    weighing(40, accel_cubic=0.9993, gyro_scale_asymmetry=0.9991, lever_arm=0.2)
    fresh.wait("document.querySelectorAll('#so-far .cause').length === 3")
    names = fresh.run("[...document.querySelectorAll('#so-far .name')].map((each) => each.textContent)")
    assert names == ["accel_cubic", "gyro_scale_asymmetry", "lever_arm"]
    fresh.driver.refresh()
    fresh.wait("document.querySelector('.tick:not(:disabled)')")
    assert fresh.text("#so-far") == ""


def test_the_saved_page_says_a_reading_with_its_noise_and_drops_a_preview_that_it_cannot_make(
    fresh, explored, first, client, tmp_path
):
    file = tmp_path / "session.html"
    file.write_bytes(client.ask("session.html")[1])
    view = json.dumps({"model": first, "channel": "gz", "x": "rate_i"})
    saved = Page(f"file://{file}#{quote(view)}")
    try:
        right, down, _ = place_of_worst(saved)
        said, same = pointed(saved, right, down), pointed(fresh, *place_of_worst(fresh)[:2])
        [value] = re.findall(r"gz(-?[\d.]+ ± [\d.]+) pulse/s", same)
        found, noise = map(float, re.search(r"gz(-?[\d.]+) ± ([\d.]+) pulse/s", said.replace("−", "-")).groups())
        expected = list(map(float, value.split(" ± ")))
        assert found == pytest.approx(expected[0], abs=noise)
        assert noise == pytest.approx(expected[1], rel=0.05)
        saved.click(f'[id="tick-{HIDDEN}"]')
        saved.wait("document.querySelector('#preview-sentence') && document.querySelector('.cell.previewed')")
        saved.run("(document.querySelectorAll('.tick:not(:checked)')[2].click(), null)")
        saved.wait("document.querySelector('#notice .fault')")
        assert "one at a time" in saved.text("#notice .fault")
        saved.wait("!document.querySelector('#preview-sentence') && !document.querySelector('.cell.previewed')")
    finally:
        saved.close()


def test_effects_of_one_name_say_their_channels(fresh):
    """The model says twice the same effect, on other channels: each chip names its own."""
    told = (
        "import('./page/state.js').then(({ tell, told }) => tell({ facts: { ...told.facts, effects: ["
        "{ name: 'gyro_bias', channels: ['gx', 'gy'] }, { name: 'gyro_bias', channels: ['gz'] },"
        "{ name: 'accel_bias', channels: [] }] } }))"
    )
    fresh.run(f"({told}, null)")
    fresh.wait("document.querySelectorAll('.chip').length === 3")
    chips = fresh.run("[...document.querySelectorAll('.chip')].map((each) => each.textContent)")
    assert chips == ["gyro_bias gx, gy×", "gyro_bias gz×", "accel_bias×"]
    names = fresh.run("[...document.querySelectorAll('.chip button')].map((each) => each.getAttribute('aria-label'))")
    assert names == ["remove gyro_bias of gx, gy", "remove gyro_bias of gz", "remove accel_bias"]


def test_a_brush_of_a_large_campaign_changes_cells_in_place(fresh):
    """336 runs of six channels: no cell is made anew, and the focus stays; benchmarks/explore.py measures the time."""
    many = (
        "import('./page/state.js').then(({ tell, told }) => {"
        "const runs = Array.from({ length: 336 }, (_, n) => `run-${n}`);"
        "tell({ facts: { ...told.facts, runs, cells: runs.flatMap((run, n) => told.facts.channels.map((channel, k) =>"
        "({ ...told.facts.cells[(n + k) % 42], run, channel }))), labels: told.facts.labels.map(({ by }) => ({ by,"
        "labels: runs })) } }); })"
    )
    fresh.run(f"({many}, null)")
    fresh.wait("document.querySelectorAll('.cell').length === 2016")
    fresh.run("(window.every = [...document.querySelectorAll('.cell')], window.first = every[0], first.focus(), null)")
    for place in range(1, 8):
        fresh.run(f"(every[{100 * place}].click(), null)")
        fresh.wait(f"every[{100 * place}].classList.contains('marked')")
    assert fresh.run("document.querySelectorAll('.cell.marked').length") == 1
    assert fresh.run("every.every((cell) => cell.isConnected) && document.activeElement === first")
