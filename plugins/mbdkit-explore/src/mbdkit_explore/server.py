"""The server of the page with sliders. It is bound to this machine, and answers only requests with its token."""

from __future__ import annotations

import asyncio
import html
import json
import math
import secrets
import socket
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future
from contextlib import suppress
from typing import TYPE_CHECKING

from mbdkit.base.errors import MbdkitError
from mbdkit_explore.explorer import Explorer, explorer_of
from mbdkit_report import render

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

HOST = "127.0.0.1"
LARGEST = 100_000  # bytes of a request
HEADERS = {
    # a notebook on this machine may show the page in a frame
    "Content-Security-Policy": "default-src 'none'; style-src 'unsafe-inline'; script-src 'unsafe-inline'; "
    "connect-src 'self'; img-src data:; base-uri 'none'; form-action 'none'; "
    "frame-ancestors http://127.0.0.1:* http://localhost:* https://localhost:* vscode-webview:",
    "Cross-Origin-Resource-Policy": "same-origin",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cache-Control": "no-store",
}


class Exploration:
    """A page that is served until `close`, or until this process ends.

    Attributes
    ----------
    url
        Address on this machine, including the token that requests must contain.
    """

    def __init__(self, explorer: Explorer, port: int = 0):
        try:
            import uvicorn
        except ImportError:
            raise MbdkitError("sliders need starlette and uvicorn: pip install 'mbdkit[explore]'") from None
        token = secrets.token_urlsafe(16)
        self._socket = socket.socket()
        try:
            self._socket.bind((HOST, port))
            self._socket.listen()  # requests before the server has started wait instead of being refused
        except (OSError, OverflowError, TypeError) as error:
            why = getattr(error, "strerror", None) or error
            raise MbdkitError(f"port {port!r} of this machine cannot be used ({why})") from None
        self.url = f"http://{HOST}:{self._socket.getsockname()[1]}/?token={token}"
        config = uvicorn.Config(
            application(explorer, token, lambda: self._server.should_exit),
            log_level="error",
            access_log=False,
            lifespan="off",
            headers=list(HEADERS.items()),
        )
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [self._socket]}, daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Wait until the server has ended."""
        while self._thread.is_alive():
            time.sleep(0.2)  # lets Ctrl-C take effect

    def close(self) -> None:
        """End the server, even if it is computing an answer."""
        self._server.should_exit = self._server.force_exit = True
        self._thread.join(5)
        self._socket.close()

    def __enter__(self) -> Exploration:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{html.escape(self.url)}" width="100%" height="760" title="mbdkit explore"></iframe>'

    def __repr__(self) -> str:
        return f"<exploration at {self.url}>"


def explore(spec: object, parameters: Sequence[str] | None = None, *, port: int = 0) -> Exploration:
    """Serve a page on this machine with sliders; motion, forces and verdict of a spec follow them.

    Notebooks show the page in the output of the cell.

    Parameters
    ----------
    spec
        A run spec or an inverse spec: a file, the name of a packaged example, or a mapping.
    parameters
        Named parameters or dotted keys of numbers, such as ``model.springs.support.stiffness``; by default the named
        parameters or, if there are none, numbers of the model. A slider ranges from half of the value to twice the
        value, or from -1 to 1 if the value is 0. The slider of an angle ranges over 30 degrees to both sides.
    port
        Port of the page; by default a free one.

    Raises
    ------
    SpecError
        If the spec is wrong, or a parameter is not one of its numbers.
    MbdkitError
        If the packages starlette and uvicorn are not installed, or the port cannot be used.
    """
    return Exploration(explorer_of(spec, parameters), port)


def application(explorer: Explorer, token: str, is_ending: Callable[[], bool]) -> Starlette:
    """Return the application that serves one page, only to requests from this machine with the token.

    Once `is_ending` returns true, it refuses requests, also those whose answer is being computed: from Python 3.12 on,
    a server waits for its connections.
    """
    from starlette.applications import Starlette
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.requests import ClientDisconnect
    from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse
    from starlette.routing import Route

    turn = asyncio.Lock()  # allows only one run at a time
    page: list[str] = []

    def is_known(text: str | None) -> bool:
        return secrets.compare_digest((text or "").encode(), token.encode())

    async def computed(request: Request, values: Mapping[str, float]) -> dict[str, object] | None:
        try:
            async with turn:
                # A page sends one request at a time. Its connection is closed if it was left or loaded again.
                if is_ending() or await request.is_disconnected():
                    return None
                result = _in_thread(explorer, values)
                while not (await asyncio.wait([result], timeout=0.1))[0]:
                    if is_ending():
                        return None
                return result.result()
        except asyncio.CancelledError:  # the server has ended; uvicorn would log this exception
            return None

    async def shown(request: Request) -> Response:
        if not is_known(request.query_params.get("token")):
            return PlainTextResponse("The address of this page contains a token; use the one that was printed.", 403)
        if not page:
            if (reference := await computed(request, {})) is None:
                return PlainTextResponse("", 503)
            names = ("key", "words", "unit", "low", "high", "value")
            sliders = [{name: getattr(slider, name) for name in names} for slider in explorer.sliders]
            data = {"sliders": sliders, "reference": reference}
            page[:] = [render("explore.html", {"title": explorer.title, "sliders": sliders, "data": data})]
        return HTMLResponse(page[0])

    async def answer(request: Request) -> Response:
        if not is_known(request.headers.get("x-token")):
            return PlainTextResponse("", 403)
        body = b""
        with suppress(ClientDisconnect):
            async for part in request.stream():
                body = (body + part)[: LARGEST + 1]  # the rest is discarded, but read: the client waits for this
        if (values := values_in(body)) is None:
            return PlainTextResponse(f"The body should be a JSON object of numbers, of at most {LARGEST} bytes.", 400)
        result = await computed(request, values)
        return PlainTextResponse("", 503) if result is None else JSONResponse(result)

    return Starlette(
        routes=[Route("/", shown), Route("/answer", answer, methods=["POST"])],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])],
    )


def values_in(body: bytes) -> dict[str, float] | None:
    """Return the values of sliders in the body of a request; None if it is too large, or not an object of finite
    numbers.
    """
    try:
        values = json.loads(body, parse_int=float) if len(body) <= LARGEST else None
    except (ValueError, RecursionError):
        return None
    is_valid = isinstance(values, dict) and all(isinstance(x, float) and math.isfinite(x) for x in values.values())
    return values if is_valid else None


def _in_thread(explorer: Explorer, values: Mapping[str, float]) -> asyncio.Future[dict[str, object]]:
    """Compute an answer in a thread of its own, for which the end of the process does not wait."""
    future: Future[dict[str, object]] = Future()
    future.set_running_or_notify_cancel()

    def compute() -> None:
        try:
            future.set_result(explorer.answer(values))
        except BaseException as error:
            future.set_exception(error)

    threading.Thread(target=compute, daemon=True).start()
    return asyncio.wrap_future(future)
