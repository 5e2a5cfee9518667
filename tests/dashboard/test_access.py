"""Access to the page as plain clients try it: tokens, origins, host names, and connections that
end before they ask."""

import itertools
import shutil
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from importlib.metadata import version
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.http11 import Request
from websockets.sync.client import connect
from websockets.typing import Origin, Subprotocol

from concord.dashboard.access import PageAccess
from concord.dashboard.app import Dashboard
from concord.dashboard.frames.stage import set_stage
from concord.dashboard.serve import open_recording
from concord.runtime.drivers import drive
from concord.runtime.recording import McapRecorder
from tests.dashboard.browser_page import row_of
from tests.dashboard.browser_tab import new_tab
from tests.dashboard.conftest import FLAGS, browser_path
from tests.dashboard.runs import setup_of
from tests.experiments.command_support import concord, refused
from tests.pages import ROOT, blocks
from tests.processes import holds_within

STAGE = set_stage(setup_of("oscillator", nodes=3, steps=4))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Dashboard]:
    file = tmp_path_factory.mktemp("access") / "run.mcap"
    recorder = McapRecorder(file, STAGE.rounds, STAGE.setup.time_step_s, STAGE.bus.frame_format)
    drive(STAGE.setup, recorder, lambda _: None)
    recorder.close()
    shown = open_recording(STAGE.setup, file, "127.0.0.1", 0, light=False)
    yield shown
    shown.close()


def place(page: Dashboard) -> str:
    """Return the host and the port of a page."""
    return urlsplit(page.url).netloc


def handshake(
    page: Dashboard,
    origin: str | None,
    query: str | None = None,
    headers: dict[str, str] | None = None,
) -> int:
    """Return the status of a websocket handshake: 101 if the page speaks, 403 if it refuses."""
    query = urlsplit(page.url).query if query is None else query
    try:
        with connect(
            f"ws://{place(page)}/?{query}",
            origin=None if origin is None else Origin(origin),
            subprotocols=[Subprotocol(f"viser-v{version('viser')}")],
            additional_headers=headers or {},
            max_size=None,
        ) as socket_of_page:
            # The page sends its widgets to each client that it lets in.
            assert len(socket_of_page.recv(timeout=20)) > 0
    except InvalidStatus as refused:
        return refused.response.status_code
    return 101


def get(page: Dashboard, path: str, **headers: str) -> tuple[int, dict[str, str], bytes]:
    """Return status, headers and body of a request."""
    asked = HTTPConnection(place(page), timeout=20)
    try:
        asked.request("GET", path, headers=headers)
        answer = asked.getresponse()
        return answer.status, dict(answer.getheaders()), answer.read()
    finally:
        asked.close()


def test_the_page_itself_is_let_in(page: Dashboard):
    assert handshake(page, f"http://{place(page)}") == 101


@pytest.mark.parametrize(
    "origin",
    [
        "http://evil.example",
        "http://127.0.0.1:9977",
        "http://127.0.0.1",
        "http://localhost",
        "null",
        "file://",
        None,
    ],
)
def test_another_origin_is_refused_though_it_has_the_token(page: Dashboard, origin: str | None):
    assert handshake(page, origin) == 403


@pytest.mark.parametrize("query", ["", "token=", "token=wrong", "token=%C3%A9", "fixedDpr=1"])
def test_a_wrong_token_is_refused_though_the_origin_is_right(page: Dashboard, query: str):
    assert handshake(page, f"http://{place(page)}", query) == 403
    status, headers, body = get(page, f"/?{query}")
    assert status == 403
    assert b"open the whole address that concord printed" in body
    assert "Set-Cookie" not in headers


def test_tokens_differ_from_page_to_page_and_are_long(page: Dashboard):
    tokens = {PageAccess("127.0.0.1").token for _ in range(50)}
    assert len(tokens) == 50
    assert min(map(len, tokens)) >= 32


def test_a_page_that_was_opened_with_its_token_needs_its_cookie_alone(page: Dashboard):
    status, headers, body = get(page, f"/?{urlsplit(page.url).query}")
    assert status == 200
    assert b"<html" in body
    cookie, *attributes = headers["Set-Cookie"].split("; ")
    assert {"HttpOnly", "SameSite=Strict"} <= set(attributes)
    assert headers["X-Frame-Options"] == "DENY"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert get(page, "/", Cookie=f"other=1; {cookie}")[0] == 200
    own, name = f"http://{place(page)}", cookie.partition("=")[0]
    assert handshake(page, own, "", {"Cookie": cookie}) == 101
    assert handshake(page, own, "", {"Cookie": f"{name}=wrong"}) == 403
    # A second page of this machine receives the cookie too.
    assert handshake(page, "http://127.0.0.1:9977", "", {"Cookie": cookie}) == 403


@pytest.mark.parametrize(
    ("host", "status"),
    [
        ("rebound.example", 403),
        ("rebound.example:8080", 403),
        ("127.0.0.1.evil.example", 403),
        ("[", 403),
        ("", 403),
        # A tunnel ends at another port.
        ("localhost:9000", 200),
        ("LOCALHOST", 200),
        ("[::1]:9000", 200),
        ("192.0.2.7:8080", 200),
    ],
)
def test_a_foreign_name_of_this_machine_is_refused(page: Dashboard, host: str, status: int):
    assert get(page, f"/?{urlsplit(page.url).query}", Host=host)[0] == status


def asked(**headers: str) -> Request:
    return Request(f"/?token={BEHIND.token}", Headers(list(headers.items())))


BEHIND = PageAccess("127.0.0.1", ["viz.example.org"])


def test_a_proxy_with_a_public_name_is_let_in():
    here = {"Host": "127.0.0.1:8080", "Upgrade": "websocket"}
    assert BEHIND.refusal(asked(Host="viz.example.org")) is None
    assert BEHIND.refusal(asked(**here, Origin="https://viz.example.org")) is None
    assert BEHIND.refusal(asked(**here, Origin="https://VIZ.example.org:8443")) is None
    for origin in (
        "https://evil.example.org",
        "https://viz.example.org.evil.org",
        "null",
        "http://[",
    ):
        text = BEHIND.refusal(asked(**here, Origin=origin))
        assert text is not None and "--public-name" in text
    other = PageAccess("127.0.0.1")
    plain = Request(f"/?token={other.token}", Headers([("Host", "viz.example.org")]))
    assert "--public-name NAME" in (other.refusal(plain) or "")
    assert other.refusal(Request(plain.path, Headers([("Host", socket.getfqdn())]))) is None


def test_a_public_name_is_a_name_alone(capsys):
    said = concord(capsys, "replay", "nowhere", "--public-name", "https://viz.example.org")
    assert "--public-name https://viz.example.org: must be a host name" in refused(said)


NGINX = """
daemon off; pid {folder}/pid; error_log stderr; worker_processes 1;
events {{ worker_connections 64; }}
http {{
  access_log off; client_body_temp_path {folder}; proxy_temp_path {folder};
  fastcgi_temp_path {folder}; uwsgi_temp_path {folder}; scgi_temp_path {folder};
  server {{
    listen 127.0.0.1:{port};
    {locations}
  }}
}}
"""


@pytest.fixture
def proxy_port(tmp_path: Path, page: Dashboard, monkeypatch: pytest.MonkeyPatch) -> Iterator[int]:
    """The port of nginx before the page, with the blocks of docs/security.md."""
    monkeypatch.setattr(page.access, "_public", {NAME})
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    config = tmp_path / "nginx.conf"
    locations = "\n".join(blocks((ROOT / "docs" / "security.md").read_text("utf-8"), "nginx"))
    locations = locations.replace("127.0.0.1:8080", place(page))
    config.write_text(NGINX.format(folder=tmp_path, port=port, locations=locations))
    proxy = subprocess.Popen([shutil.which("nginx") or "", "-c", str(config), "-p", str(tmp_path)])
    try:
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), 20).close()
                break
            except ConnectionRefusedError:
                assert proxy.poll() is None
                time.sleep(0.05)
        yield port
    finally:
        proxy.terminate()
        proxy.wait(20)


NAME = "viz.example.org"
needs_nginx = pytest.mark.skipif(shutil.which("nginx") is None, reason="nginx is not installed")
PATHS = ["/", "/user/ada/proxy/8080/"]
# The dashboard's only time goes on from test to test.
CLOCK_S = itertools.count(1)


@needs_nginx
@pytest.mark.parametrize("path", PATHS)
def test_nginx_passes_the_page_on(path: str, page: Dashboard, proxy_port: int):
    token = urlsplit(page.url).query
    asked = HTTPConnection("127.0.0.1", proxy_port, timeout=20)
    asked.request("GET", f"{path}?{token}", headers={"Host": NAME})
    answer = asked.getresponse()
    assert answer.status == 200 and b"<html" in answer.read()
    asked.close()
    for origin, status in ((f"https://{NAME}", 101), ("https://evil.example", 403)):
        try:
            with connect(
                f"ws://127.0.0.1:{proxy_port}{path}?{token}",
                origin=Origin(origin),
                subprotocols=[Subprotocol(f"viser-v{version('viser')}")],
                max_size=None,
            ) as through:
                assert len(through.recv(timeout=20)) > 0
            assert status == 101
        except InvalidStatus as refusal:
            assert refusal.response.status_code == status


@needs_nginx
@pytest.mark.browser
@pytest.mark.parametrize("path", PATHS)
def test_a_browser_shows_the_page_behind_nginx(
    path: str, page: Dashboard, proxy_port: int, chromium
):
    flags = [*FLAGS, f"--host-resolver-rules=MAP {NAME} 127.0.0.1"]
    browser = chromium.browser_type.launch(executable_path=browser_path(), args=flags)
    try:
        tab = new_tab(browser)

        def draws(holds: Callable[[], bool]) -> bool:
            def drawn_holds() -> bool:
                page.tick(float(next(CLOCK_S)))
                return holds()

            return holds_within(60, drawn_holds, lambda: tab.wait_for_timeout(50))

        tab.goto(f"http://{NAME}:{proxy_port}{path}?{urlsplit(page.url).query}&fixedDpr=0.5")
        assert draws(lambda: tab.get_by_test_id("run-state").count() > 0)
        assert draws(lambda: tab.get_by_test_id("nodes").first.locator("tr").count() > 3)
        # A press goes back through the proxy.
        row = tab.locator(row_of(PATHS.index(path)))
        assert "background" not in (row.get_attribute("style") or "")
        row.click()
        assert draws(lambda: "background" in (row.get_attribute("style") or ""))
    finally:
        browser.close()


def test_the_files_of_the_page_are_refused_without_a_token(page: Dashboard):
    assert get(page, "/index.html")[0] == 403


_BARE = """
import socket, sys, time
from concord.dashboard.access import PageAccess
from concord.dashboard.window import PageServer
window = PageServer("127.0.0.1", 0)
port = window.server.get_port()
twice = b"GET /?token=1 HTTP/1.1\\r\\n" + 2 * b"Host: 127.0.0.1\\r\\n" + b"\\r\\n"
for said in (b"", b"\\x16\\x03\\x01\\x02", twice):
    with socket.create_connection(("127.0.0.1", port)) as bare:
        bare.sendall(said)
        bare.shutdown(socket.SHUT_WR)
        bare.settimeout(20)
        while bare.recv(4096):
            pass
window.server.stop()
"""


def test_a_bare_connection_prints_nothing():
    ended = subprocess.run(
        [sys.executable, "-c", _BARE], capture_output=True, text=True, timeout=120, check=True
    )
    assert ended.stdout == ""
    assert ended.stderr == ""
