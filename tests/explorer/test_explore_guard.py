"""Who is refused: without the token, by a foreign name or page, outside of the session; needs no fit."""

import asyncio
import hashlib
from pathlib import Path

import pytest

import imubayes_explorer
from imubayes_explorer.guard import Guard, new_token

PORT = 4711
OWN = {"host": f"127.0.0.1:{PORT}"}
CHANGE = {**OWN, "origin": f"http://127.0.0.1:{PORT}", "content-type": "application/json", "content-length": "2"}


def status(path: str, headers: dict[str, str], method: str = "GET", kind: str = "http") -> int:
    """Return the status that a guarded application answers with; 200 is its own."""
    sent = []

    async def inside(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": []})

    async def send(message):
        sent.append(message)

    async def receive():
        return {"type": "http.request"}

    given = [(name.encode(), value.encode()) for name, value in headers.items()]
    scope = {"type": kind, "path": path, "method": method, "headers": given}
    asyncio.run(Guard(inside, "token", PORT)(scope, receive, send))
    return sent[0]["status"]


def test_the_own_page_is_answered():
    assert status("/token/", OWN) == 200
    assert status("/token/", {"host": f"localhost:{PORT}"}) == 200
    assert status("/token/state", {**OWN, "origin": f"http://localhost:{PORT}"}) == 200
    assert status("/token/change", CHANGE, "POST") == 200


@pytest.mark.parametrize(
    "path", ["/", "/state", "/tokens/", "/toke/", "//token/", "/TOKEN/", "/tok%65n", "/tökén/", ""]
)
def test_without_the_token_nothing_is_answered(path):
    assert status(path, OWN) == 403


@pytest.mark.parametrize(
    "host", ["evil.example", f"evil.example:{PORT}", "127.0.0.1", "127.0.0.1:1", f"127.0.0.1:{PORT}.evil"]
)
def test_a_foreign_name_is_refused(host):
    assert status("/token/", {"host": host}) == 403


def test_no_name_is_refused():
    assert status("/token/", {}) == 403


@pytest.mark.parametrize(
    "origin", ["http://evil.example", "null", f"https://127.0.0.1:{PORT}", "http://127.0.0.1:8888"]
)
@pytest.mark.parametrize("method", ["GET", "POST"])
def test_a_foreign_page_is_refused(origin, method):
    assert status("/token/state", {**CHANGE, "origin": origin}, method) == 403


@pytest.mark.parametrize("lacking", ["origin", "content-type", "content-length"])
def test_a_change_comes_from_the_page_as_json(lacking):
    assert status("/token/change", {name: value for name, value in CHANGE.items() if name != lacking}, "POST") == 403


@pytest.mark.parametrize(
    "other", [{"content-type": "text/plain"}, {"content-length": "2000000"}, {"content-length": "-1"}]
)
def test_forms_and_floods_are_refused(other):
    assert status("/token/change", CHANGE | other, "POST") == 403


def test_a_socket_is_refused():
    assert status("/token/", OWN, kind="websocket") == 403


def test_tokens_are_long_and_differ():
    tokens = {new_token() for _ in range(100)}
    assert len(tokens) == 100
    assert min(map(len, tokens)) >= 32


PAGE = Path(imubayes_explorer.__file__).parent / "page"
RELEASED = {
    "uPlot.iife.min.js": "19c8d4c6ad88929a79f4ae49d6f7161566dfd0ba3d15cc495e974f787eb78f1f",
    "uPlot.min.css": "df630c6a8d6f8eeaff264b50f73ce5b114f646ffd9a0bb74f049b0a00135fa04",
    "uPlot.LICENSE.txt": "8f989229699b4fe2f1a0432d0e9edc338a8a911e250e2d1b01ecd770a5f5b1bd",
}
"""uPlot 1.6.32, the files of its npm package as released."""


def test_the_charts_are_those_released():
    found = {file.name: hashlib.sha256(file.read_bytes()).hexdigest() for file in (PAGE / "vendor").iterdir()}
    assert found == RELEASED


def test_own_scripts_are_small_and_name_no_other_host():
    lines = {file.name: len(file.read_text().splitlines()) for file in PAGE.glob("*.js")}
    assert max(lines.values()) <= 250
    assert sum(lines.values()) <= 2500
    for file in (*PAGE.glob("*.js"), *PAGE.glob("*.html"), *PAGE.glob("*.css")):
        text = file.read_text().replace("http://www.w3.org/2000/svg", "")
        assert "://" not in text, file.name
        assert "innerHTML" not in text, file.name  # names from files stay text
