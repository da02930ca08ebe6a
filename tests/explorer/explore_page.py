"""A window on an explored session in Debian's Chromium."""

import json
import shutil
from urllib.parse import unquote

from explore_client import wait_for
from selenium import webdriver
from selenium.common.exceptions import StaleElementReferenceException, WebDriverException
from selenium.webdriver.chrome.service import Service
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By

BROWSER, DRIVER = shutil.which("chromium"), shutil.which("chromedriver")
LACKING = BROWSER is None or DRIVER is None


class Page:
    """A window on the session."""

    def __init__(self, address: str, width: int = 1280, height: int = 800, *, wait: bool = True):
        options = webdriver.ChromeOptions()
        options.binary_location = BROWSER or ""
        for argument in ("headless=new", "no-sandbox", "disable-gpu", "disable-dev-shm-usage", "disable-extensions",
                         "force-prefers-reduced-motion", f"window-size={width},{height}"):  # fmt: skip
            options.add_argument(f"--{argument}")
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Service(DRIVER))
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}  # of what the page has
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
        self.address, self.requested = address.partition("#")[0], set[str]()
        if wait:
            self.open(address)

    def open(self, address: str) -> None:
        """Open a page and wait until its map and its points are drawn."""
        self.driver.get(address)
        self.wait(
            "document.querySelectorAll('.cell').length > 0 && document.querySelector('#legend').children.length > 0"
        )

    def run(self, script: str):
        return self.driver.execute_script(f"return {script}")

    def wait(self, script: str):
        def found():
            try:
                return self.run(script)
            except WebDriverException:
                return None

        return wait_for(found)

    def text(self, selector: str) -> str:
        return self.run(f"document.querySelector({json.dumps(selector)})?.textContent ?? ''")

    def click(self, selector: str) -> None:
        """Click what is there; a panel that was drawn anew meanwhile has another element in its place."""

        def clicked() -> bool:
            try:
                self.driver.find_element(By.CSS_SELECTOR, selector).click()
            except StaleElementReferenceException:
                return False
            return True

        wait_for(clicked)

    def press(self, *keys: str) -> None:
        ActionChains(self.driver).send_keys(*keys).perform()

    def view(self) -> dict:
        return json.loads(unquote(self.run("location.hash"))[1:] or "{}")

    def complaints(self) -> list[str]:
        """Return what the console says, and requests to any other host."""
        told = [each["message"] for each in self.driver.get_log("browser")]
        for each in self.driver.get_log("performance"):
            message = json.loads(each["message"])["message"]
            if message["method"] == "Network.requestWillBeSent":
                self.requested.add(message["params"]["request"]["url"])
        own = (self.address, "data:", "blob:", "chrome:", "about:")
        return told + [url for url in self.requested if not url.startswith(own)]

    def close(self) -> None:
        self.driver.quit()
