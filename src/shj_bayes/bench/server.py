"""Who may use a bench, and how it begins and ends.

Only this machine reaches it (127.0.0.1), and on it only who holds the token: a file that this user alone may read hands
it to the browser, which gets a cookie for it. Pages of other origins could still send requests here, under a name that
they point at this address (DNS rebinding) or by forms: every request must name this host, and one that comes from a
page must come from ours.
"""

import asyncio
import contextlib
import secrets
import socket
import sys
import time
import webbrowser
from collections.abc import AsyncIterator, Callable, Iterator
from functools import partial
from html import escape
from pathlib import Path
from tempfile import TemporaryDirectory
from types import FrameType

import uvicorn
from starlette.applications import Starlette
from starlette.requests import Request
from starlette.responses import Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from shj_bayes._util.files import alone, make_writable, write_text
from shj_bayes._util.processes import PYTHON
from shj_bayes.bench.archive import unpack
from shj_bayes.bench.routes import HEADERS, ROUTES, Bench, answered, cookie_name
from shj_bayes.errors import CampaignError, ShjError

HOST = "127.0.0.1"
IDLE_S = 3600.0  # without anybody who looks, and without work
MOST_CONNECTIONS = 100


def guarded(app: ASGIApp, port: int, cookie: str) -> ASGIApp:
    """Let in only requests to this host, from our own pages, by who holds the cookie; everything else gets 403."""

    async def let_in(scope: Scope, receive: Receive, send: Send) -> None:
        if scope["type"] == "websocket":
            await receive()
            await send({"type": "websocket.close", "code": 1008})
            return
        why = refusal(Request(scope), f"{HOST}:{port}", cookie_name(port), cookie) if scope["type"] == "http" else ""
        answer: ASGIApp = Response(f"shj-bayes bench: refused ({why})\n", 403, HEADERS, "text/plain") if why else app
        await answer(scope, receive, send)

    return let_in


def refusal(request: Request, host: str, name: str, cookie: str) -> str:
    """Why a request is not for us; empty where it is. `name` is that of the cookie."""
    headers, reading = request.headers, request.method in ("GET", "HEAD")
    origin, site = headers.get("origin"), headers.get("sec-fetch-site")
    known = secrets.compare_digest(request.cookies.get(name, "").encode(), cookie.encode())
    entering = request.url.path == "/enter"  # from the file that hands the token over, which has no origin
    refusals = {
        "another host": headers.getlist("host") != [host],
        "not the way in": entering and (reading or origin not in (None, "null")),
        "another origin": not entering and origin not in (None, f"http://{host}"),
        "no origin": not entering and not reading and origin is None,
        "another site": not entering and site not in (None, "same-origin", "none"),
        "no token: open the bench by its command": not entering and not known,
    }
    return next((why for why, refused in refusals.items() if refused), "")


def application(bench: Bench, port: int) -> ASGIApp:
    """Make the application of a bench."""
    bench.port = port

    @contextlib.asynccontextmanager
    async def life(_: Starlette) -> AsyncIterator[None]:
        bench.jobs.warm()
        try:
            yield
        finally:
            bench.jobs.stop()

    routes = [Route(path, answered(handler), methods=methods.split()) for path, methods, handler in ROUTES]
    app = Starlette(routes=routes, lifespan=life)
    app.state.bench = bench
    return guarded(app, port, bench.cookie)


@contextlib.contextmanager
def way_in(bench: Bench) -> Iterator[Path]:
    """Give a file that only this user may read, which hands the token to a browser that opens it."""
    address = f"http://{HOST}:{bench.port}/enter"
    text = (
        '<!DOCTYPE html><html lang="en"><head><meta charset="utf-8"><meta name="referrer" content="no-referrer">'
        f"<title>shj-bayes bench</title></head><body><form method=post enctype=text/plain action={escape(address)}>"
        f'<input type=hidden name=token value="{bench.token}"><button>Open the bench</button></form>'
        "<script>document.forms[0].submit()</script></body></html>"
    )
    with TemporaryDirectory(prefix="shj-bayes-bench-", ignore_cleanup_errors=True) as place:
        path = Path(place, "open.html")
        path.touch(0o600, exist_ok=False)
        path.write_text(text, encoding="utf-8")
        yield path


def opened(place: Path) -> Path:
    """Give the folder of a bench; a file that a bench made is unpacked beside itself first."""
    if place.is_file():
        folder = place.with_suffix("")
        unpack(place, folder)
        return folder
    return place


def put_shortcut(folder: Path) -> str:
    """Put an entry that opens a bench on the desk, or in the home folder where there is no desk; say where it is."""
    desk = Path.home() / "Desktop" if (Path.home() / "Desktop").is_dir() else Path.home()
    place = str(folder.resolve())
    if any(c in place for c in '"\r\n%$`'):
        raise CampaignError(f"{folder.name}: a shortcut cannot hold the path {place!r}; move the folder, or rename it")
    run = f'"{PYTHON[0]}" {PYTHON[1]} -m shj_bayes bench "{place}"'
    entry = f"[Desktop Entry]\nType=Application\nName=shj-bayes bench\nTerminal=true\nExec={run}\n"
    name, text = {
        "win32": ("shj-bayes bench.bat", f"@echo off\r\n{run}\r\n"),
        "darwin": ("shj-bayes bench.command", f"#!/bin/sh\nexec {run}\n"),
    }.get(sys.platform, ("shj-bayes-bench.desktop", entry))
    write_text(desk / name, text)
    if sys.platform != "win32":
        (desk / name).chmod(0o755)
    return f"{desk / name}: opens a bench on {place}"


def serve(folder: Path, *, browser: bool, tell: Callable[[str], None]) -> None:
    """Serve a bench on a folder until it is ended or nobody has looked for an hour."""
    make_writable(folder)
    with contextlib.ExitStack() as held:
        try:
            held.enter_context(alone(folder / "bench"))
        except ShjError as error:
            raise CampaignError(
                f"a bench is open on {folder.name} already; go on in its page, or end it first (Ctrl-C where it was "
                "begun)"
            ) from error
        bench = Bench(folder)
        listening = held.enter_context(socket.socket(socket.AF_INET, socket.SOCK_STREAM))
        listening.bind((HOST, 0))
        listening.listen()  # who comes before the server is ready waits
        bench.port = listening.getsockname()[1]
        where = held.enter_context(way_in(bench))
        tell(f"bench: {where.as_uri()}\nopen this file in a browser of this machine; Ctrl-C ends the bench")
        config = uvicorn.Config(
            application(bench, bench.port),
            log_level="critical",
            access_log=False,
            ws="none",
            limit_concurrency=MOST_CONNECTIONS,
            timeout_keep_alive=5,
            timeout_graceful_shutdown=2,
            server_header=False,
            date_header=False,
        )
        server = _Server(config, bench)
        show = partial(webbrowser.open, where.as_uri()) if browser else None
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_until_idle(server, bench, listening, show))
        tell("the bench is ended; what was finished is kept, and what was not goes on from its last checkpoint")


class _Server(uvicorn.Server):
    """A server that says goodbye to the pages that are open, so that none waits for more."""

    def __init__(self, config: uvicorn.Config, bench: Bench) -> None:
        super().__init__(config)
        self.bench = bench

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        """Take the signal that ends it."""
        self.bench.say("ended", "")
        super().handle_exit(sig, frame)


async def _until_idle(
    server: uvicorn.Server, bench: Bench, listening: socket.socket, show: Callable[[], bool] | None
) -> None:
    """Serve; end when nobody has looked for a while and nothing runs."""
    serving = asyncio.create_task(server.serve(sockets=[listening]))
    if show is not None:
        await asyncio.to_thread(show)
    while not serving.done():
        await asyncio.wait([serving], timeout=5.0)
        bench.jobs.rest()
        if not bench.listeners and not bench.jobs.under_way and time.monotonic() - bench.last_seen > IDLE_S:
            bench.say("ended", "")
            server.should_exit = True
    await serving
