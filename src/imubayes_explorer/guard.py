"""Who may ask: windows of this machine that know the token, at this server's own name and from its own page.

The token is the first part of every path.  The name in `Host` must be this server's, which stops foreign names that
were pointed at this machine (DNS rebinding).  A request that names another `Origin` is refused, and one that changes
something must come from the page itself.  Answers forbid the page to load anything from elsewhere.
"""

import hmac
import secrets
from collections.abc import Awaitable, Callable, MutableMapping
from typing import Any

from starlette.responses import PlainTextResponse

Scope = MutableMapping[str, Any]
Receive = Callable[[], Awaitable[MutableMapping[str, Any]]]
Send = Callable[[MutableMapping[str, Any]], Awaitable[None]]
Application = Callable[[Scope, Receive, Send], Awaitable[None]]

HOST = "127.0.0.1"
_NAMES = (HOST, "localhost")
_MOST_BYTES = 1_000_000
_HEADERS = (
    (b"content-security-policy", b"default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; "
     b"connect-src 'self'; font-src 'self'; base-uri 'none'; form-action 'none'; "
     b"frame-ancestors 'self' http://localhost:* http://127.0.0.1:*"),
    (b"x-content-type-options", b"nosniff"),
    (b"referrer-policy", b"no-referrer"),
    (b"cache-control", b"no-store"),
    (b"cross-origin-resource-policy", b"same-origin"),
)  # fmt: skip


def new_token() -> str:
    """Return a random token of 192 bits."""
    return secrets.token_urlsafe(24)


class Guard:
    """Passes on what may be asked, with the path behind the token; refuses all else with 403.

    Parameters
    ----------
    styles : where styles of the page may come from.
    """

    def __init__(self, application: Application, token: str, port: int, styles: bytes = b"'self'"):
        policy = _HEADERS[0][1].replace(b"style-src 'self'", b"style-src " + styles)
        self._headers = ((_HEADERS[0][0], policy), *_HEADERS[1:])
        self._application, self._token = application, token.encode()
        self._hosts = {f"{name}:{port}".encode() for name in _NAMES}
        self._origins = {b"http://" + host for host in self._hosts}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Answer one request."""
        if scope["type"] == "lifespan":
            await self._application(scope, receive, send)
            return
        refusal = self._refusal(scope) if scope["type"] == "http" else "this server answers HTTP only"
        if refusal:
            answer = PlainTextResponse(f"refused: {refusal}\n", 403)
            answer.raw_headers.extend(self._headers)
            await answer(scope, receive, send)
            return
        token = scope["path"].removeprefix("/").partition("/")[0]
        inner = {**scope, "root_path": f"/{token}"}

        async def sent(message: MutableMapping[str, Any]) -> None:
            if message["type"] == "http.response.start":
                message = {**message, "headers": [*message.get("headers", ()), *self._headers]}
            await send(message)

        await self._application(inner, receive, sent)

    def _refusal(self, scope: Scope) -> str:
        """Return why a request is refused; empty if it is not."""
        headers: dict[bytes, bytes] = {}
        for name, value in scope["headers"]:
            if name in headers and name in (b"host", b"origin"):
                return f"the header {name.decode()} is given twice"
            headers[name] = value
        if headers.get(b"host") not in self._hosts:
            return "the request names another server"
        origin = headers.get(b"origin")
        if origin is not None and origin not in self._origins:
            return "the request comes from another page"
        given = scope["path"].removeprefix("/").partition("/")[0].encode("utf-8", "replace")
        if not hmac.compare_digest(given, self._token):
            return "the token is missing or wrong: use the address that `imubayes explore` printed"
        if scope["method"] in ("GET", "HEAD"):
            return ""
        return self._refusal_of_change(headers, origin)

    @staticmethod
    def _refusal_of_change(headers: dict[bytes, bytes], origin: bytes | None) -> str:
        if origin is None:
            return "a change must name the page that it comes from"
        if headers.get(b"content-type", b"").partition(b";")[0] != b"application/json":
            return "a change is sent as JSON"
        length = headers.get(b"content-length", b"")
        return "" if length.isdigit() and int(length) <= _MOST_BYTES else "the request is too large, or has no length"
