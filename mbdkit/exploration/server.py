"""The server of the page with sliders. It is bound to this machine, and answers only requests with its token."""

from __future__ import annotations

import html
import secrets
import socket
import threading
import time
from collections.abc import Sequence
from types import TracebackType
from typing import TYPE_CHECKING, Any

from mbdkit.base.errors import MbdkitError
from mbdkit.exploration.explorer import Explorer, explorer_of
from mbdkit.report.templating import render

if TYPE_CHECKING:
    from starlette.applications import Starlette
    from starlette.requests import Request
    from starlette.responses import Response

HOST = "127.0.0.1"
LARGEST = 100_000  # bytes of a request


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
        except OSError as error:
            raise MbdkitError(f"port {port} of this machine cannot be used ({error.strerror})") from None
        self.url = f"http://{HOST}:{self._socket.getsockname()[1]}/?token={token}"
        config = uvicorn.Config(application(explorer, token), log_level="error", access_log=False)
        self._server = uvicorn.Server(config)
        self._thread = threading.Thread(target=self._server.run, kwargs={"sockets": [self._socket]}, daemon=True)
        self._thread.start()

    def wait(self) -> None:
        """Wait until the server has ended."""
        while self._thread.is_alive():
            time.sleep(0.2)  # lets Ctrl-C take effect

    def close(self) -> None:
        """End the server."""
        self._server.should_exit = True
        self._thread.join(5)
        self._socket.close()

    def __enter__(self) -> Exploration:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def _repr_html_(self) -> str:
        return f'<iframe src="{html.escape(self.url)}" width="100%" height="760" title="mbdkit explore"></iframe>'

    def __repr__(self) -> str:
        return f"<exploration at {self.url}>"


def explore(spec: Any, parameters: Sequence[str] | None = None, *, port: int = 0) -> Exploration:
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


def application(explorer: Explorer, token: str) -> Starlette:
    """Return the application that serves one page, only to requests from this machine with the token."""
    from starlette.applications import Starlette
    from starlette.concurrency import run_in_threadpool
    from starlette.middleware import Middleware
    from starlette.middleware.trustedhost import TrustedHostMiddleware
    from starlette.responses import HTMLResponse, JSONResponse, PlainTextResponse
    from starlette.routing import Route

    lock = threading.Lock()  # allows only one run at a time
    page: list[str] = []

    def is_known(given: str | None) -> bool:
        return secrets.compare_digest((given or "").encode(), token.encode())

    def answered(values: dict[str, float]) -> dict[str, Any]:
        with lock:
            return explorer.answer(values)

    async def shown(request: Request) -> Response:
        if not is_known(request.query_params.get("token")):
            return PlainTextResponse("The address of this page contains a token; use the one that was printed.", 403)
        if not page:
            reference = await run_in_threadpool(answered, {})
            sliders = [
                {"key": one.key, "words": one.words, "unit": one.unit, "low": one.low, "high": one.high,
                 "value": one.value} for one in explorer.sliders
            ]  # fmt: skip
            data = {"sliders": sliders, "reference": reference}
            page.append(render("explore.html", {"title": explorer.title, "sliders": sliders, "data": data}))
        return HTMLResponse(page[0], headers={"Referrer-Policy": "no-referrer", "Cache-Control": "no-store"})

    async def answer(request: Request) -> Response:
        if not is_known(request.headers.get("x-token")):
            return PlainTextResponse("", 403)
        body = await request.body()
        values = await request.json() if len(body) <= LARGEST else None
        if not isinstance(values, dict) or not all(isinstance(one, int | float) for one in values.values()):
            return PlainTextResponse("", 400)
        return JSONResponse(await run_in_threadpool(answered, values))

    return Starlette(
        routes=[Route("/", shown), Route("/answer", answer, methods=["POST"])],
        middleware=[Middleware(TrustedHostMiddleware, allowed_hosts=[HOST, "localhost"])],
    )
