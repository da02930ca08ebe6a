"""A page that is served on this machine until it is stopped."""

import socket
import threading
import time
from collections.abc import Callable

import uvicorn

from imubayes.foundations.errors import input_error
from imubayes_explorer.guard import HOST, Application, new_token

PATIENCE = 10.0
"""Seconds in which the server starts or ends."""


class Served:
    """A server of this machine.

    Parameters
    ----------
    application : makes it from a token and a port.
    port : of the server; any free one if 0.

    Attributes
    ----------
    address : of its page; the token in it is the key.
    """

    def __init__(self, application: Callable[[str, int], Application], port: int = 0):
        # Bound before anything is said: the port of the address is this server's own.
        try:
            bound = socket.create_server((HOST, port))
        except (OSError, OverflowError) as error:
            raise input_error(f"the port cannot be opened: "
                              f"{getattr(error, 'strerror', None) or error}", f"--port {port}",
                              "a free port, or 0 for any", "choose another one") from error  # fmt: skip
        token = new_token()
        self.address = f"http://{HOST}:{bound.getsockname()[1]}/{token}/"
        served = application(token, bound.getsockname()[1])
        # Given by a factory, which uvicorn need not distinguish from an application.
        settings = uvicorn.Config(
            lambda: served, factory=True, interface="asgi3", ws="none", lifespan="off", proxy_headers=False,
            server_header=False, log_level="warning", access_log=False, timeout_graceful_shutdown=1,
        )  # fmt: skip
        self._server = uvicorn.Server(settings)
        self._thread = threading.Thread(target=self._server.run, args=([bound],), name="explore-server", daemon=True)

    def begin(self) -> None:
        """Serve in a thread; return once the page is there."""
        self._thread.start()
        until = time.monotonic() + PATIENCE
        while not self._server.started and time.monotonic() < until:
            time.sleep(0.01)

    def wait(self) -> None:
        """Serve until the process is interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def end(self) -> None:
        """Stop serving."""
        self._server.should_exit = True
        self._thread.join(PATIENCE)
