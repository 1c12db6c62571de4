"""The product as an operator meets it: a service process, simulated vehicles on sockets, a real headless browser."""

from __future__ import annotations

import json
import os
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import httpx2
from selenium import webdriver
from selenium.common.exceptions import (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    NoSuchElementException,
    StaleElementReferenceException,
)
from selenium.webdriver.chrome.service import Service as Driver
from selenium.webdriver.common.action_chains import ActionChains
from selenium.webdriver.common.by import By
from selenium.webdriver.common.keys import Keys
from selenium.webdriver.remote.webelement import WebElement

from tests.ports import free_port

CHROMIUM, CHROMEDRIVER = shutil.which("chromium"), shutil.which("chromedriver")
SPEEDUP = 8.0
LIMIT_S = 120.0
START_LIMIT_S = 240.0
"""A service that nobody has run before compiles its planner first."""
IMAGES = Path(__file__).resolve().parents[2] / "docs" / "images"
NOT_YET = (
    ElementClickInterceptedException,
    ElementNotInteractableException,
    NoSuchElementException,
    StaleElementReferenceException,
)
Result = TypeVar("Result")


class Service:
    """`skyfolio serve` as a process on loopback."""

    def __init__(self, folder: Path, speedup: float, *options: str, **settings: str) -> None:
        self.fleet_port, port = free_port(socket.SOCK_DGRAM), free_port(socket.SOCK_STREAM)
        self.url = f"http://127.0.0.1:{port}"
        self.log = folder / "service.log"
        command = [sys.executable, "-m", "skyfolio", "serve", "--port", str(port), "--time-scale", str(speedup)]
        command += ["--fleet-url", f"udpin://127.0.0.1:{self.fleet_port}", "--database-url", "temporary", *options]
        with self.log.open("wb") as sink:
            self._process = subprocess.Popen(
                command, stdout=sink, stderr=sink, cwd=folder, env=environment() | settings
            )
        self.client = httpx2.Client(base_url=self.url, timeout=120)
        self._until_ready()

    @property
    def endpoint(self) -> str:
        """Where vehicles send to."""
        return f"udpout://127.0.0.1:{self.fleet_port}"

    def call(self, method: str, path: str, **options: Any) -> Any:
        """One REST call; the JSON."""
        answer = self.client.request(method, path, **options)
        assert answer.status_code < 400, answer.text
        return answer.json()

    def _until_ready(self) -> None:
        deadline = time.monotonic() + START_LIMIT_S
        while time.monotonic() < deadline:
            assert self._process.poll() is None, self.log.read_text()
            try:
                if self.client.get("/health").status_code == 200:
                    return
            except httpx2.TransportError:
                pass
            time.sleep(0.1)
        raise AssertionError(f"not ready: {self.log.read_text()}")

    def stop(self) -> None:
        """End the process."""
        self.client.close()
        self._process.terminate()
        try:
            self._process.wait(15)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class Page:
    """One browser tab at the dashboard. Everything waits for what it needs, as long as a loaded machine may take."""

    def __init__(self, downloads: Path, resolver: str = "MAP * ~NOTFOUND, EXCLUDE 127.0.0.1") -> None:
        options = webdriver.ChromeOptions()
        options.binary_location = str(CHROMIUM)
        for argument in (
            "--headless=new",
            "--no-sandbox",
            "--disable-gpu",
            "--disable-dev-shm-usage",
            "--hide-scrollbars",
            "--window-size=1280,800",
            f"--host-resolver-rules={resolver}",
        ):
            options.add_argument(argument)
        options.add_experimental_option("prefs", {"download.default_directory": str(downloads)})
        options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
        self.driver = webdriver.Chrome(options=options, service=Driver(str(CHROMEDRIVER)))
        self.driver.set_script_timeout(LIMIT_S)
        self._url = ""
        self.resize(1280, 800)

    def open(self, url: str, path: str = "/ui/") -> None:
        """Go to a page of the dashboard of the service at `url` and wait until it is alive."""
        self.at(url, path)
        self.see("header .sf-what")

    def at(self, url: str, path: str) -> None:
        """Go to any page of the service at `url`."""
        self._url = url
        self.driver.get(f"{url}{path}")

    def reload(self) -> None:
        """Load the page anew, as F5 does."""
        self.driver.refresh()

    def leave(self) -> None:
        """Look at nothing, in what counts as a new tab: the service may end."""
        self.driver.execute_script("try { sessionStorage.clear(); } catch (_) {}")
        self.driver.get("about:blank")

    def resize(self, width: int, height: int) -> None:
        """The size of the visible page, whatever window there is."""
        size = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
        self.driver.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)

    def prefer(self, theme: str) -> None:
        """The theme the operator's system asks for: light or dark."""
        features = [{"name": "prefers-color-scheme", "value": theme}]
        self.driver.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": features})

    def until(self, what: Callable[[], Result | None], why: str, limit_s: float = LIMIT_S) -> Result:
        """Wait until `what` gives something true."""
        deadline = time.monotonic() + limit_s
        while True:
            try:
                found = what()
            except NOT_YET:
                found = None
            if found:
                return found
            if time.monotonic() > deadline:
                raise AssertionError(f"not within {limit_s:g} s: {why}\n{self.text('body')[:3000]}")
            time.sleep(0.05)

    def see(self, css: str, words: str = "") -> WebElement:
        """Wait for a visible element that contains these words."""

        def found() -> WebElement | None:
            elements = self.driver.find_elements(By.CSS_SELECTOR, css)
            return next((one for one in elements if one.is_displayed() and words in one.text), None)

        return self.until(found, f"{css} with {words!r}")

    def text(self, css: str) -> str:
        """All the text in an element, empty when there is none."""
        found = self.driver.find_elements(By.CSS_SELECTOR, css)
        return found[0].text if found else ""

    def button(self, label: str) -> WebElement:
        """The visible button with this label. Raises NoSuchElementException."""
        path = f"//button[normalize-space(.)='{label}' or @aria-label='{label}']"
        for one in reversed(self.driver.find_elements(By.XPATH, path)):  # dialogs come last
            if one.is_displayed():
                return one
        raise NoSuchElementException(label)

    def press(self, label: str) -> None:
        """Click the button with this label as soon as that is possible."""

        def pressed() -> bool:
            button = self.button(label)
            if button.is_enabled():
                button.click()
                return True
            return False

        self.until(pressed, f"button {label!r} that can be pressed")

    def choose(self, label: str, option: str) -> None:
        """Pick an option, by a part of its text, of the select with this label."""
        field = self.until(lambda: self._field(label), f"select {label!r}")
        self._click(field)
        self._click(self.see(".q-menu .q-item", option))

    def _click(self, element: WebElement) -> None:
        def clicked() -> bool:
            element.click()
            return True

        self.until(clicked, f"{element.tag_name} that can be clicked")

    def _field(self, label: str) -> WebElement | None:
        fields = self.driver.find_elements(By.CSS_SELECTOR, ".q-select")
        return next((one for one in fields if one.is_displayed() and label in one.text), None)

    def click_map(self, x: float, y: float) -> None:
        """Click the map at these shares of its width and height."""
        canvas = self.see(".sf-map canvas")
        size = canvas.size
        across, down = round((x - 0.5) * size["width"]), round((y - 0.5) * size["height"])
        ActionChains(self.driver).move_to_element_with_offset(canvas, across, down).click().perform()

    def map_says(self, what: str) -> str:
        """What the first map tells about itself: frames, uavs or lost."""
        return str(self.run("return document.querySelector('.sf-map').dataset[arguments[0]] ?? ''", what))

    def upload(self, *files: Path) -> None:
        """Give files to the page's file chooser, all at once."""
        self.driver.find_element(By.CSS_SELECTOR, "input[type=file]").send_keys("\n".join(map(str, files)))

    def type(self, label: str, value: str) -> None:
        """Replace what is in the field with this label."""
        field = self.driver.find_element(By.CSS_SELECTOR, f"input[aria-label='{label}']")
        field.send_keys(Keys.CONTROL, "a")
        field.send_keys(value, Keys.TAB)

    def keys(self, name: str, times: int = 1) -> None:
        """Press a key, `SHIFT+H` with its modifier, where the focus is."""
        *modifiers, key = name.split("+")
        chain = ActionChains(self.driver)
        for modifier in modifiers:
            chain.key_down(getattr(Keys, modifier))
        for _ in range(times):
            chain.send_keys(getattr(Keys, key) if hasattr(Keys, key) else key)
        for modifier in modifiers:
            chain.key_up(getattr(Keys, modifier))
        chain.perform()

    def points(self, css: str) -> int:
        """How many points the first series of a chart has."""
        script = """
            const chart = getElement(document.querySelector(arguments[0]).id.slice(1)).chart;
            return chart.getOption().series[0].data.length;"""
        return int(self.run(script, css))

    def unreachable_controls(self) -> list[str]:
        """Visible controls that no keyboard reaches or that have no name."""
        found: list[str] = self.run("""
            const shown = [...document.querySelectorAll("button, a[href], input, [role=slider], [tabindex]")]
              .filter((one) => one.offsetParent !== null);
            const name = (one) => one.getAttribute("aria-label") || one.textContent.trim() || one.title
              || one.closest("label, [role=slider], [role=alertdialog]")?.textContent.trim()
              || one.closest("[aria-label]")?.getAttribute("aria-label");
            return shown.filter((one) => !name(one) || (one.tabIndex < 0 && one.tagName === "BUTTON" && !one.disabled))
              .map((one) => one.outerHTML.slice(0, 200));""")
        return found

    def run(self, script: str, *arguments: Any) -> Any:
        """Run JavaScript."""
        return self.driver.execute_script(script, *arguments)

    def shot(self, name: str) -> None:
        """A screenshot for the documentation."""
        IMAGES.mkdir(parents=True, exist_ok=True)
        time.sleep(0.4)  # let the last frame be drawn
        self.driver.save_screenshot(str(IMAGES / f"{name}.png"))

    def complaints(self) -> list[str]:
        """Errors on the console, and requests to anybody but the service."""
        logs = {kind: self.driver.get_log(kind) for kind in ("browser", "performance")}  # type: ignore[no-untyped-call]
        found = [row["message"] for row in logs["browser"] if row["level"] in {"SEVERE", "WARNING"}]
        for row in logs["performance"]:
            message = json.loads(row["message"])["message"]
            if message["method"] in {"Network.requestWillBeSent", "Network.webSocketCreated"}:
                params = message["params"]
                asked: str = params.get("url") or params["request"]["url"]
                local = asked.rsplit("://", maxsplit=1)[-1].startswith(self._url.split("://")[-1])
                if not local and not asked.startswith(("data:", "blob:", "chrome:", "about:")):
                    found.append(f"external request: {asked}")
        return found

    def close(self) -> None:
        """End the browser."""
        self.driver.quit()


def missing_browser() -> str | None:
    """Why browser tests cannot run here, None if they can."""
    if CHROMIUM and CHROMEDRIVER:
        return None
    return "chromium and chromedriver are not installed (Debian: apt-get install chromium chromium-driver)"


def key_for(folder: Path, role: str) -> tuple[str, str]:
    """A database with one key of this role: its URL, and the key."""
    url = f"sqlite+aiosqlite:///{folder / role}.db"
    command = [
        sys.executable,
        "-m",
        "skyfolio",
        "keys",
        "create",
        "tower",
        "--role",
        role,
        "--json",
        "--database-url",
        url,
    ]
    done = subprocess.run(command, capture_output=True, text=True, check=True, env=environment(), cwd=folder)
    return url, json.loads(done.stdout)["key"]


def environment() -> dict[str, str]:
    """Of a process that runs this very source."""
    root = str(Path(__file__).resolve().parents[2])
    paths: Sequence[str] = [root, *filter(None, [os.environ.get("PYTHONPATH")])]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(paths), "PYTHONUNBUFFERED": "1"}
