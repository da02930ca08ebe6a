"""The loop on campaigns with two hidden effects and with one outside the catalogue, and on a server that is killed."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from urllib.parse import quote

import jax
import pytest
from explore_client import Client, settled, wait_for
from explore_page import LACKING, Page
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys

from imubayes.api import fit
from imubayes_explorer.start import Exploration, explore

pytestmark = [
    pytest.mark.slow,  # fits of their own; test_explore_page guards the walk, test_explore_session what is kept
    pytest.mark.skipif(LACKING, reason="Debian's chromium and chromium-driver are not here"),
]
ROOT = Path(__file__).parents[2]


def begun(name: str, place: Path):
    result = fit(ROOT / "data" / name, ROOT / "models" / "hidden-effects.toml", place / name, sample=False)
    found = explore(result)
    settled(found)
    return found


@pytest.fixture(scope="module")
def two(tmp_path_factory):
    found = begun("hidden-two", tmp_path_factory.mktemp("two"))
    yield found
    found.stop()


@pytest.fixture(scope="module")
def outside(tmp_path_factory):
    found = begun("hidden-outside", tmp_path_factory.mktemp("outside"))
    yield found
    found.stop()


def test_two_effects_are_previewed_together_and_added_by_keys(two):
    """Ticked in the list, refitted within a second, then fitted; nothing is missing after."""
    page = Page(two.address)
    try:
        said = page.text("#sentence")
        hidden = page.run("[...document.querySelectorAll('.tick')].slice(0, 2).map((each) => each.id.slice(5))")
        assert all(effect in said for effect in hidden), (said, hidden)
        page.press("c", Keys.SPACE)
        page.wait("document.querySelectorAll('.tick:checked').length === 1")
        page.run("(document.querySelectorAll('.tick')[1].focus(), null)")
        page.press(Keys.SPACE)
        page.wait("document.querySelectorAll('.tick:checked').length === 2")
        for effect in hidden:
            page.wait(f"document.querySelector('#preview-sentence')?.textContent.includes('{effect}')")
        page.press(Keys.ENTER)
        page.wait("document.querySelector('#refit-sentence')?.textContent.startsWith('Refitted (add ')")
        page.wait("document.querySelector('#cancel')")  # the fit goes on
        early = page.text("#refit-sentence")
        page.wait("document.querySelector('#sentence')?.textContent.includes('explains the data')")
        drops = [re.search(r"observed (\d+)", text)[1] for text in (early, page.text("#notice"))]
        assert drops[0] == drops[1]
        exported = Client(two.address).ask("model.toml")[1].decode()
        assert all(f'name = "{effect}"' in exported for effect in hidden)
        assert page.complaints() == []
    finally:
        page.close()


def test_what_is_outside_the_catalogue_becomes_an_effect_by_its_formula(outside):
    page = Page(outside.address)
    try:
        before = outside.session.state().tree[0].chi2
        page.press("f")
        page.wait("document.querySelector('#add-formula')")
        page.click("#add-formula")
        page.wait("document.querySelector('#cancel')")
        settled(outside)
        [made] = [line for line in outside.session.state().tree if line.parent]
        assert made.taken
        assert made.chi2 < before - 50
        page.wait("document.querySelector('#tab-panel').textContent.includes('found_gyro_shape')")
        # Its file is needed beside the model: that is reported, with the command that writes both.
        page.press("e")
        page.wait("document.querySelector('#notice .fault')")
        assert "found_shape" in page.text("#notice .fault")
        assert "--export model.toml" in page.text("#notice .fault")
    finally:
        page.close()


def served(root: Path) -> tuple[subprocess.Popen[str], str]:
    command = [sys.executable, "-c", "from imubayes.cli.main import run; raise SystemExit(run())",
               "explore", str(root), "--no-browser"]  # fmt: skip
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True, env=os.environ)
    assert process.stdout is not None
    for line in process.stdout:
        if found := re.search(r"http://\S+", line):
            return process, found[0]
    raise AssertionError("no address was told")


def ended(process: subprocess.Popen[str]) -> None:
    process.send_signal(signal.SIGKILL)
    process.wait()
    assert process.stdout is not None
    process.stdout.close()


def test_a_server_that_is_killed_during_a_fit_loses_nothing_that_was_done(two, tmp_path):
    """Commands, notes and models are there again; of the fit at work nothing is left, and it can be begun anew."""
    root = tmp_path / "root"
    shutil.copytree(two.session.root, root)
    process, address = served(root)
    try:
        client = Client(address)
        model = wait_for(lambda: client.json("state")["tree"])[0]["id"]
        wait_for(lambda: client.ask("model", {"model": model})[0] == 200)
        client.json("note", {"model": model, "name": "before the kill"})
        client.json("change", {"model": model, "add": ["gyro_scale_asymmetry"]})
        wait_for(lambda: any(task["step"].startswith("fitting") for task in client.json("state")["tasks"]))
        page = Page(address)
        try:
            done = client.json("state")
            ended(process)
            page.wait("document.querySelector('#notice').textContent.includes('The server has stopped')")
        finally:
            page.close()
        process, address = served(root)
        again = wait_for(lambda: Client(address).json("state"))
        assert again["commands"] == done["commands"]
        assert [(line["id"], line["name"]) for line in again["tree"]] == [(model, "before the kill")]
        wait_for(lambda: Client(address).ask("model", {"model": model})[0] == 200)
        task = Client(address).json("change", {"model": model, "add": ["gyro_scale_asymmetry"]})["task"]
        wait_for(lambda: json.loads(Client(address).ask("state")[1])["tasks"][-1]["state"] == "done")
        made = next(each for each in Client(address).json("state")["tasks"] if each["number"] == task)["made"]
        assert made in {line["id"] for line in Client(address).json("state")["tree"]}
    finally:
        ended(process)


def p95(times: list[float]) -> float:
    return sorted(times)[round(0.95 * (len(times) - 1))]


def root_of(explored: Exploration) -> str:
    return next(line.id for line in explored.session.state().tree if not line.parent)


def at_the_root(explored: Exploration) -> Page:
    """A window on the first model, whatever was done and selected before; its previews are ready."""
    view = {"model": root_of(explored), "channel": "gz", "x": "rate_i"}
    page = Page(f"{explored.address}#{quote(json.dumps(view))}")
    page.wait("document.querySelector('.tick:not(:disabled)')")
    return page


class Counted:
    """A window whose clicks and drags are counted from the moment that it is there."""

    def __init__(self, page: Page):
        self.page, self.clicks, self.began = page, 0, time.monotonic()

    def click(self, selector: str) -> None:
        self.page.wait(f"document.querySelector({json.dumps(selector)})?.disabled === false")
        self.page.click(selector)
        self.clicks += 1

    def drag(self, left: float, top: float, right: float, down: float) -> None:
        """Drag over the residuals; places are shares of the panel, from its middle."""
        over = self.page.driver.find_element(By.CSS_SELECTOR, "#residuals .u-over")
        width, height = over.rect["width"], over.rect["height"]
        drag = ActionChains(self.page.driver).move_to_element_with_offset(over, int(left * width), int(top * height))
        drag.click_and_hold().move_by_offset(int(right * width), int(down * height)).release().perform()
        self.clicks += 1

    def said(self, walk: str) -> str:
        return f"{walk}: {self.clicks} clicks, {time.monotonic() - self.began:.0f} s"


def test_select_fit_and_undo_are_four_gestures(two, capsys):
    """The walk of pintk: drag over residuals, tick a parameter, `Fit`, `Revert`: as many as here.

    Its window (src/pint/pintk/plk.py of PINT) has these buttons; no times of it are published.
    """
    page, first = at_the_root(two), root_of(two)
    try:
        walk = Counted(page)
        walk.drag(-0.49, -0.47, 0.3, 0.9)
        page.wait("document.querySelector('#selection-sentence')")
        walk.click(".tick:not(:checked)")
        walk.click("#accept")
        page.wait("document.querySelector('#refit-sentence')")
        shown = walk.said("pintk's select, fit: residuals of the refit")
        page.wait(f"JSON.parse(decodeURIComponent(location.hash.slice(1))).model !== {json.dumps(first)}")
        fitted = walk.said("with the fit itself")
        walk.click("#undo")
        page.wait(f"JSON.parse(decodeURIComponent(location.hash.slice(1))).model === {json.dumps(first)}")
        with capsys.disabled():
            print(f"\n{shown}; {fitted}; {walk.said('with undo')}")
        assert walk.clicks == 4
        assert page.complaints() == []
    finally:
        page.close()
        settled(two)


def test_the_next_best_model_is_taken_in_two_clicks_and_seen_beside_the_one_before_by_a_third(two, capsys):
    """The walk of Monolix: the model that is proposed is applied, run, and compared with the one before.

    Its documentation describes the section `Proposal` of the results and the play button, and counts neither clicks nor
    seconds.
    """
    page = at_the_root(two)
    try:
        walk = Counted(page)
        walk.click("#tick-named")
        page.wait("document.querySelector('#preview-sentence')")
        walk.click("#accept")
        page.wait("document.querySelector('#refit-sentence')")
        shown = walk.said("Monolix's next best model: its residuals")
        page.wait("document.querySelector('#sentence')?.textContent.includes('explains the data')")
        walk.click("#side-by-side")
        page.wait("document.querySelector('#beside-title').textContent.startsWith('residual of the previous model')")
        with capsys.disabled():
            print(f"\n{shown}; {walk.said('fitted, beside the one before')}")
        assert walk.clicks == 3
        assert page.complaints() == []
    finally:
        page.close()
        settled(two)


def test_no_preview_waits_for_a_program_to_compile(two, capsys):
    """Every cause is previewed for the first time, as by pointing at it; what that takes is printed."""
    client, model = Client(two.address), root_of(two)
    wait_for(lambda: (found := two.session.get(model)) is not None and found.stage == "ready")
    causes = [cause["effect"] for cause in client.json("model", {"model": model})["causes"]]
    compiled = list[str]()
    listen = jax.monitoring.register_event_duration_secs_listener
    listen(lambda name, seconds, **_: compiled.append(name) if name.endswith("backend_compile_duration") else None)

    def seconds(path: str, wanted: object) -> float:
        began = time.monotonic()
        client.json(path, wanted)
        return time.monotonic() - began

    previews = [seconds("preview", {"model": model, "effects": [effect]}) for effect in causes]
    brushes = [
        seconds("selection", {"model": model, "brushes": [{"x": "rate_i", "x_low": low, "x_high": low + 60}]})
        for low in range(-300, 300, 20)
    ]
    with capsys.disabled():
        print(f"\n{len(previews)} first previews: p95 {p95(previews):.3f} s, longest {max(previews):.3f} s; "
              f"{len(brushes)} brushes: p95 {p95(brushes):.3f} s, longest {max(brushes):.3f} s")  # fmt: skip
    assert compiled == []
    assert len(previews) >= 20
