"""A client of an explored session, as its page is one."""

import http.client
import json
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from imubayes_explorer.start import Exploration

PATIENCE = 300.0
"""Seconds; a fit that compiles takes a minute of an idle machine."""


@dataclass(frozen=True)
class Client:
    """Asks a server as its own page does, unless stated otherwise."""

    address: str

    @property
    def host(self) -> str:
        return self.address.split("/")[2]

    @property
    def token(self) -> str:
        return self.address.split("/")[3]

    def ask(self, path: str, body: Any = None, *, whole: bool = False, **headers: str) -> tuple[int, bytes]:
        connection = http.client.HTTPConnection(*self.host.split(":"), timeout=60)
        told = {"Host": self.host} | (
            {} if body is None else {"Origin": f"http://{self.host}", "Content-Type": "application/json"}
        )
        sent = {name.replace("_", "-"): value for name, value in headers.items()}
        kept = {name: value for name, value in (told | sent).items() if value}
        place = path if whole else f"/{self.token}/{path}"
        connection.request("GET" if body is None else "POST", place, None if body is None else json.dumps(body), kept)
        answer = connection.getresponse()
        found = answer.status, answer.read()
        connection.close()
        return found

    def json(self, path: str, body: Any = None) -> Any:
        status, content = self.ask(path, body)
        assert status in (200, 202), (path, status, content[:300])
        return json.loads(content)


def framed(client: Client, wanted: Any) -> tuple[Any, dict[str, np.ndarray]]:
    """Return the header of the points of a view, and their columns."""
    status, content = client.ask("points", wanted)
    assert status == 200, content
    (length,) = struct.unpack("<I", content[:4])
    head = json.loads(content[4 : 4 + length])
    numbers = np.frombuffer(content[4 + length :], "<f4").reshape(len(head["arrays"]), head["count"])
    return head, dict(zip(head["arrays"], numbers, strict=True))


def wait_for(condition: Callable[[], Any], patience: float = PATIENCE) -> Any:
    until = time.monotonic() + patience
    while time.monotonic() < until:
        found = condition()
        if found:
            return found
        time.sleep(0.05)
    raise AssertionError("it did not happen in time")


def settled(explored: Exploration) -> None:
    wait_for(lambda: not explored.session.worker.busy)
