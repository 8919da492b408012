"""Who may load the page and open its socket."""

from __future__ import annotations

import hashlib
import hmac
import ipaddress
from urllib.parse import urlsplit

from aiohttp import web

from rig_display.parameters import TOKEN_LENGTH
from shared_control.parameters import ParameterError

__all__ = ["HEADERS", "Gate"]

_COOKIE = "rig_display"
_LOOPBACK = ("127.0.0.1", "localhost", "::1")

#: On every response. Nothing comes from elsewhere, nothing runs that is not a file of the page, nobody frames it; the
#: page has its process for itself, which gives it clocks of full resolution.
HEADERS = {
    "Content-Security-Policy": (
        "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
        "base-uri 'none'; form-action 'self'; frame-ancestors 'none'"
    ),
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Embedder-Policy": "require-corp",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


def is_loopback(host: str) -> bool:
    """Whether an address to listen on can be reached from this machine only."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


class Gate:
    """Token, host and origin.

    Raises
    ------
    ParameterError: an address that others can reach, without a token; a token that can be guessed.
    """

    def __init__(self, host: str, token: str) -> None:
        if not token and not is_loopback(host):
            raise ParameterError(
                f"display: host {host!r} can be reached by others and needs a token "
                f"of {TOKEN_LENGTH} characters or more: set the parameter token, or RIG_DISPLAY_TOKEN"
            )
        if token and len(token) < TOKEN_LENGTH:
            raise ParameterError(
                f"display: a token of {len(token)} characters can be guessed; it must have {TOKEN_LENGTH} or more"
            )
        self._token = token
        # The browser keeps what follows from the token, not the token.
        self._cookie = hashlib.sha256(token.encode()).hexdigest()
        self._hosts = {*_LOOPBACK, host}

    def admit(self, request: web.Request) -> None:
        """Let a request through, or raise what is to be answered instead: 303 with a cookie, or 403."""
        self._check_host(request)
        if not self._token:
            return
        given = request.query.get("token")
        if given is not None and hmac.compare_digest(given.encode(), self._token.encode()):
            # The token leaves the address bar, where it could be read over a shoulder.
            response = web.HTTPSeeOther(request.path)
            response.set_cookie(_COOKIE, self._cookie, httponly=True, samesite="Lax", path="/")
            raise response
        if given is None and hmac.compare_digest(request.cookies.get(_COOKIE, "").encode(), self._cookie.encode()):
            return
        raise web.HTTPForbidden(
            text=_ask("This token is not the right one." if given is not None else "This page needs a token."),
            content_type="text/html",
        )

    def check_origin(self, request: web.Request) -> None:
        """Refuse (403) a socket that a page of another origin opens: browsers do not."""
        origin = request.headers.get("Origin", "")
        if not origin or urlsplit(origin).netloc != request.host:
            raise web.HTTPForbidden(text=f"origin {origin or 'missing'} is not that of this page\n")

    def _check_host(self, request: web.Request) -> None:
        # Without a token, a foreign name that resolves to this machine would be let in by its own page's origin.
        if not self._token and urlsplit(f"//{request.host}").hostname not in self._hosts:
            raise web.HTTPForbidden(text=f"host {request.host} is not a name of this machine here\n")


def _ask(sentence: str) -> str:
    return (
        '<!doctype html><html lang="en"><meta charset="utf-8"><title>Token</title>'
        '<link rel="stylesheet" href="/static/style.css"><body class="ask"><main>'
        f'<h1>{sentence}</h1><form action="/" method="get"><label>Token <input name="token" type="password" '
        'autocomplete="off" autofocus></label> <button>Open</button></form><p>It was printed where the rig was '
        "started.</p></main></body></html>"
    )
