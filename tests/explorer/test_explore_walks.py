"""The loop on campaigns with two hidden effects and with one outside the catalogue, and on a server that is killed."""

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from explore_client import Client, settled, wait_for
from explore_page import LACKING, Page
from selenium.webdriver.common.keys import Keys

from imubayes.api import fit
from imubayes_explorer.start import explore

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
        # Its file is needed beside the model: that is told, with the command that writes both.
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
            page.wait("document.querySelector('#notice').textContent.includes('The server is gone')")
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
