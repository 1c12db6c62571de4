"""Pages of strangers in a real Chromium beside a service without keys: rebinding, forms, frames; and a sub-path."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest
from selenium.webdriver.common.by import By

from tests.dashboard.stack import Page, Service, key_for, missing_browser
from tests.proxy import Proxy, running

pytestmark = [
    pytest.mark.browser,
    pytest.mark.skipif(missing_browser() is not None, reason=missing_browser() or ""),
    pytest.mark.filterwarnings("default"),
]
EVIL = "evil.example"
RESOLVED = f"MAP {EVIL} 127.0.0.1, MAP * ~NOTFOUND, EXCLUDE 127.0.0.1"
"""What an attacker's name server does once its page is loaded."""
POST = """const done = arguments[arguments.length - 1];
fetch(arguments[0], {method: "POST", mode: "no-cors", credentials: "include", body: '{"action": "land"}'})
  .then((answer) => done([answer.type, answer.status]), (error) => done(["error", String(error)]));"""
SOCKET = """const done = arguments[arguments.length - 1];
const socket = new WebSocket(arguments[0]);
socket.onopen = () => done("open"); socket.onerror = () => done("refused");"""


class Stranger(BaseHTTPRequestHandler):
    """A site of somebody else: whatever is asked for, a page with a form and a frame that lead to the service."""

    target = ""

    def do_GET(self) -> None:
        """The page."""
        page = f"""<!doctype html><title>stranger</title><iframe id="frame" src="{self.target}/ui/"></iframe>
            <form id="form" method="post" action="{self.target}/v1/operations/op-1:abort" enctype="text/plain">
            <input name='{{"action": "land", "x": "' value='"}}'></form>"""
        self.send_response(200)
        self.send_header("content-type", "text/html")
        self.end_headers()
        self.wfile.write(page.encode())

    def log_message(self, *_: Any) -> None:
        """Say nothing."""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("strangers")


@pytest.fixture(scope="module")
def service(folder: Path) -> Iterator[Service]:
    made = Service(folder, 8.0)
    yield made
    made.stop()


@pytest.fixture(scope="module")
def browser(folder: Path) -> Iterator[Page]:
    made = Page(folder, resolver=RESOLVED)
    yield made
    made.close()


@pytest.fixture
def stranger(service: Service) -> Iterator[str]:
    """The URL of a page of another site."""
    handler = type("Aimed", (Stranger,), {"target": service.url})
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    server.block_on_close = False  # a browser keeps connections
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://{EVIL}:{server.server_address[1]}/"
    server.shutdown()
    thread.join()
    server.server_close()


def refusals(service: Service, status: int) -> int:
    """How many commands were refused like this, by the audit log."""
    rows = service.call("GET", "/v1/audit", params={"limit": 200})["items"]
    return sum(row["status"] == status and row["method"] == "POST" for row in rows)


def test_a_name_that_was_rebound_to_loopback_reads_and_commands_nothing(browser: Page, service: Service) -> None:
    driver, port = browser.driver, service.url.rsplit(":", 1)[1]
    driver.get(f"http://{EVIL}:{port}/ui/")
    assert "is not a name of this service" in browser.text("body")
    before = refusals(service, 421)
    answer = driver.execute_async_script(POST, "/v1/operations/op-1:abort")
    assert answer[1] == 421
    assert refusals(service, 421) > before  # a browser may ask again over another connection, and is refused again
    path = "/ui/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    assert driver.execute_async_script(SOCKET, f"ws://{EVIL}:{port}{path}") == "refused"


def test_a_page_of_another_site_commands_nothing_by_form_script_or_socket(
    browser: Page, service: Service, stranger: str
) -> None:
    driver = browser.driver
    driver.get(stranger)
    before = refusals(service, 403)
    answer = driver.execute_async_script(POST, f"{service.url}/v1/operations/op-1:abort")
    assert answer[0] == "error"  # not even the refusal is shown
    path = "/ui/_nicegui_ws/socket.io/?EIO=4&transport=websocket"
    address = service.url.replace("http", "ws") + path
    assert driver.execute_async_script(SOCKET, address) == "refused"
    driver.execute_script("document.getElementById('form').submit()")
    browser.until(lambda: "Only pages of this service" in browser.text("body"), "the refusal")
    browser.until(lambda: refusals(service, 403) >= before + 2, "both in the audit log")


def test_the_dashboard_is_not_shown_in_a_frame_of_another_site(browser: Page, stranger: str) -> None:
    driver = browser.driver
    driver.get(stranger)
    driver.switch_to.frame("frame")
    assert not driver.find_elements(By.CSS_SELECTOR, "header")
    assert "skyfolio" not in browser.text("body")
    driver.switch_to.default_content()
    complaints = " ".join(browser.complaints())
    assert "frame-ancestors" in complaints or "X-Frame-Options" in complaints


def test_the_description_is_shown_without_asking_anybody_else(browser: Page, service: Service) -> None:
    browser.complaints()
    browser.at(service.url, "/docs")
    browser.see("h2, h1", "skyfolio")
    browser.until(lambda: "/v1/plans" in browser.text("body"), "the routes")
    assert browser.complaints() == []


def test_below_a_sub_path_a_pilot_signs_in_and_the_dashboard_lives(browser: Page, folder: Path) -> None:
    url, key = key_for(folder, "pilot")
    service = Service(folder, 8.0, "--database-url", url, SKYFOLIO_TRUSTED_PROXIES="127.0.0.1")
    port = int(service.url.rsplit(":", 1)[1])
    told = {"X-Forwarded-Prefix": "/sky", "X-Forwarded-For": "192.0.2.7"}
    try:
        with running(Proxy(port, "/sky", headers=told)) as proxy:
            browser.complaints()
            browser.at(proxy.url, "/sky/")
            browser.driver.find_element(By.ID, "k").send_keys(key)
            browser.press("Sign in")
            browser.see(".sf-overlay h2", "No operation yet")
            browser.press("Make a plan")
            browser.see('nav a[aria-current="page"]', "Plan")
            browser.see(".sf-sub", "3 UAVs, 9 users")
            assert browser.driver.current_url == f"{proxy.url}/sky/ui/plan"
            assert browser.complaints() == []
            browser.leave()
    finally:
        service.stop()
