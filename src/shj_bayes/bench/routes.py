"""The routes of a bench: what a page may ask for, and what it gets.

No path of a browser is ever opened; it names what there is by ids. What fails is told in words.
"""

import asyncio
import json
import os
import re
import secrets
import shlex
import sys
import tempfile
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from pathlib import Path
from typing import Any

from starlette.background import BackgroundTask
from starlette.requests import ClientDisconnect, Request
from starlette.responses import FileResponse, HTMLResponse, JSONResponse, Response, StreamingResponse

from shj_bayes._util.files import replacing, shipped
from shj_bayes._util.processes import CallFailedError
from shj_bayes.bench.archive import pack
from shj_bayes.bench.jobs import Job, Jobs
from shj_bayes.bench.session import (
    MANIFEST,
    Session,
    bring,
    history_in,
    place_for,
    place_for_history,
    reading_of,
    same_as,
)
from shj_bayes.errors import CampaignError, ShjError, system_words, words_of
from shj_bayes.options import MarginOptions, flag_of
from shj_bayes.recording.limits import MAX_BYTES
from shj_bayes.report.page import environment_of, is_ours

LONGEST_QUEUE = 200  # of what is still to be told to a page
LONGEST_JSON = 1_000_000  # bytes of what a page says
SLOWEST_S, SLOWEST_BYTES = 20.0, 20_000  # of an upload: so many bytes in so many seconds, or it is refused
STILL_S = 15.0  # without news, after which a page is told that the bench is still there
FOREIGN = "sandbox; default-src 'none'; style-src 'unsafe-inline'; img-src data:; frame-ancestors 'self'"
POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self' data:; connect-src 'self'; "
    "frame-src 'self'; form-action 'none'; base-uri 'none'; frame-ancestors 'none'"
)
HEADERS = {
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "no-referrer",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}
HERE, PAGES = Path(__file__).parent, Path(__file__).parents[1] / "report"
STATIC = {
    **{f"{name}.js": HERE / "scripts" / f"{name}.js" for name in ("bench", "files", "devices", "design")},
    **{f"{name}.js": PAGES / "scripts" / f"{name}.js" for name in ("sheet", "loops")},
    "style.css": PAGES / "templates" / "style.css",
    "bench.css": HERE / "templates" / "bench.css",
}
KINDS = {".js": "text/javascript", ".css": "text/css"}
REPORTS = {"report": "report.html", "margins": "margins.html"}
OF_DEVICE = {"report": "report.html", "diagnosis": "diagnosis/diagnosis.html", "plan": "next/plan.html"}
LIMITS = ("max_stroke_mm", "max_speed_mm_s", "max_force_kN", "max_minutes", "rate_Hz")  # of a rig
STORIES = {"demo": "campaign.toml", "clean": "clean.toml", "prying": "prying.toml"}
GLOSSARY_CELLS = 7
Handler = Callable[["Bench", Request], Awaitable[Any]]


def cookie_name(port: int) -> str:
    """Name of the cookie: cookies hold for all ports of a host."""
    return f"shj_bench_{port}"


class Bench:
    """A folder, its work, and those who look at it."""

    def __init__(self, folder: Path) -> None:
        self.session = Session(folder)
        self.jobs = Jobs(self._job_changed)
        self.token, self.cookie = secrets.token_hex(32), secrets.token_hex(32)
        self.listeners: set[asyncio.Queue[tuple[str, Any]]] = set()
        self.last_seen = time.monotonic()
        self.overview: dict[str, Any] = {"devices": []}
        self.port = 0
        # what was told of a file or of a check of a device, by its id, with all that it rests on
        self.told: dict[str, tuple[str, dict[str, Any]]] = {}

    async def ask(self, name: str, *args: Any) -> Any:
        """Call a function of `work` on the folder at once."""
        return await self.jobs.ask(name, self.session.folder, *args)

    def begin(self, kind: str, target: str, *args: Any) -> dict[str, Any]:
        """Begin a function of `work` on the folder that takes long."""
        return self.jobs.begin(kind, target, self.session.folder, *args).told()

    async def told_of(self, key: str, rests_on: str, name: str, *args: Any) -> dict[str, Any]:
        """Give what a function of `work` says of a file or device, as it did before where that rests on the same."""
        if self.told.get(key, ("",))[0] != rests_on:
            self.told[key] = rests_on, await self.ask(name, *args)
        return self.told[key][1]

    async def found_in(self, key: str) -> dict[str, Any]:
        """Give what was found in a file, read as its device says."""
        path, chosen = self.session.file(key), reading_of(self.session, key)
        found = await self.told_of(key, reading_stamp(path, chosen), "read_file", path, chosen)
        given = (name for name in ("columns", "units", "sheet") if name in chosen)
        again = self.command("check", path, *(word for name in given for word in (f"--{name}", chosen[name])))
        return {"id": key, **found, "options": chosen, "command": again}

    def _job_changed(self, job: Job) -> None:
        self.say("job", job.told())
        if not job.under_way:
            self.say("changed", job.kind)

    def say(self, kind: str, content: Any) -> None:
        """Tell all pages that are open."""
        for queue in self.listeners:
            if queue.qsize() < LONGEST_QUEUE:
                queue.put_nowait((kind, content))

    async def changed(self) -> dict[str, Any]:
        """Write what was changed of sets and devices, tell all pages, and give everything that one shows."""
        self.session.write()
        self.say("changed", "sets")
        return await self.state()

    async def state(self) -> dict[str, Any]:
        """Everything that a page shows at first."""
        self.overview = await self.ask("overview")
        known = {(one["set"], one["name"]): one for one in self.overview["devices"]}
        sets = [
            {
                "id": group.id,
                "name": group.name,
                "connection": group.content.get("connection", {}),
                "note": group.content.get("note", ""),
                "devices": [
                    {
                        **known.get((group.name, device.name), {}),
                        "id": device.id,
                        "name": device.name,
                        "files": device.files,
                        "options": device.content.get("options", {}),
                        "note": device.content.get("note", ""),
                        "passed": self._passed(device.id),
                    }
                    for device in group.devices
                ],
            }
            for group in self.session.sets
        ]
        return {
            "folder": self.session.folder.name,
            **{name: self.overview[name] for name in ("error", "pooled", "changed", "pages")},
            "files": [{"id": key, "name": path.name} for key, path in self.session.files.items()],
            "sets": sets,
            "jobs": [job.told() for job in self.jobs.under_way],
            "command": self.command("campaign", self.session.folder / MANIFEST, "-o", self.session.folder),
        }

    def command(self, *words: object) -> str:
        """Give the command that does the same."""
        texts = list(map(str, words))
        quoted = (f'"{text}"' if " " in text else text for text in texts)
        return f"shj-bayes {' '.join(quoted) if sys.platform == 'win32' else shlex.join(texts)}"

    def stamp(self, key: str) -> str:
        """Give what the check of a device rests on."""
        group, device = self.session.device(key)
        files = [(str(p), p.stat().st_mtime_ns) for p in map(self.session.file, device.files) if p.exists()]
        options = [self.session.top.get("defaults"), group.content.get("options"), device.content.get("options")]
        return json.dumps([group.name, device.name, files, options, device.content.get("runs")])

    def _passed(self, key: str) -> bool | None:
        rests_on, found = self.told.get(key, ("", {}))
        return bool(found["passed"]) if rests_on == self.stamp(key) else None


def reading_stamp(path: Path, options: dict[str, Any]) -> str:
    """Give what the reading of a file rests on."""
    return json.dumps([options, path.stat().st_mtime_ns if path.exists() else 0])


class BodyError(CampaignError):
    """What is sent is too large, too slow, or not what a page of ours says."""


async def body_of(request: Request, most: int) -> AsyncIterator[bytes]:
    """Parts of what is sent: no more than allowed, and no slower."""
    too_large = BodyError(f"more than {most // 1024**2 or 1} MiB; export fewer channels or rows")
    stated = request.headers.get("content-length", "0")
    if not stated.isdigit() or int(stated) > most:
        raise too_large
    size, begun, seen, stream = 0, time.monotonic(), 0, request.stream()
    while True:
        try:
            part = await asyncio.wait_for(anext(stream), SLOWEST_S)
        except StopAsyncIteration:
            return
        except TimeoutError as error:
            raise BodyError("the upload stood still; send the file again") from error
        size += len(part)
        if size > most:
            raise too_large
        if time.monotonic() - begun > SLOWEST_S:
            if size - seen < SLOWEST_BYTES:
                raise BodyError("the upload was too slow; send the file again")
            begun, seen = time.monotonic(), size
        yield part


async def received(request: Request, path: Path) -> None:
    """Put what is sent into a file, whole or not at all."""
    with replacing(path) as part, part.open("wb") as stream:
        async for piece in body_of(request, MAX_BYTES):
            stream.write(piece)


async def said(request: Request) -> dict[str, Any]:
    """Read what a page says, as JSON."""
    text = b"".join([part async for part in body_of(request, LONGEST_JSON)])
    try:
        return {**json.loads(text or b"{}")}
    except (TypeError, ValueError, RecursionError) as error:
        raise BodyError("what the page said is no table as JSON; load the page again") from error


async def stated(request: Request) -> dict[str, Any]:
    """Read what a page says without fields that were left empty."""
    return {name: value for name, value in (await said(request)).items() if value not in ("", None, False)}


def answered(handler: Handler) -> Callable[[Request], Awaitable[Response]]:
    """Make a route of a function of the bench: what it gives is JSON, what fails is told in words."""

    async def route(request: Request) -> Response:
        bench: Bench = request.app.state.bench
        bench.last_seen = time.monotonic()
        try:
            result = await handler(bench, request)
        except BodyError as error:
            return JSONResponse({"refused": str(error)}, 413, HEADERS)
        except (ShjError, CallFailedError) as error:  # what the page asked for cannot be: it says so, in these words
            return JSONResponse({"refused": str(error)}, headers=HEADERS)
        except ClientDisconnect:
            return Response(status_code=499)
        except Exception as error:  # told to the page in words, never as a traceback
            told = system_words(error) if isinstance(error, OSError) else words_of(error)
            return JSONResponse({"refused": told}, 500, HEADERS)
        return result if isinstance(result, Response) else JSONResponse(result, headers=HEADERS)

    return route


async def enter(bench: Bench, request: Request) -> Response:
    """Take the token from the file that hands it over, and give a cookie for it."""
    given = b"".join([part async for part in body_of(request, 1000)]).decode("ascii", "replace").strip()
    if not secrets.compare_digest(given.removeprefix("token=").encode(), bench.token.encode()):
        return Response("shj-bayes bench: refused (an old token: open the bench by its command)\n", 403, HEADERS)
    # A page of ours goes on to the bench: a cookie that is strict is not sent on the way from another origin.
    page = (
        '<!DOCTYPE html><html lang="en"><title>shj-bayes</title><meta http-equiv="refresh" content="0; url=/"></html>'
    )
    answer = HTMLResponse(page, headers=HEADERS | {"Content-Security-Policy": "default-src 'none'"})
    answer.set_cookie(cookie_name(bench.port), bench.cookie, httponly=True, samesite="strict")
    return answer


async def front(bench: Bench, _: Request) -> Response:
    """Give the page."""
    page = environment_of("shj_bayes.bench", "shj_bayes.report").get_template("bench.html")
    text = page.render(folder=bench.session.folder.name, glossary=glossary())
    return HTMLResponse(text, headers=HEADERS | {"Content-Security-Policy": POLICY})


def glossary() -> dict[str, str]:
    """Meaning of each term of the glossary, by its term and by its sign."""
    meanings: dict[str, str] = {}
    for line in shipped("docs", "glossary.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip().replace("\\|", "|").replace("`", "") for cell in re.split(r"(?<!\\)\|", line)]
        if len(cells) == GLOSSARY_CELLS and cells[1] not in ("term", "---"):
            term, unit, sign, meaning = cells[1:5]
            meaning += f" ({unit})" if unit not in ("", "1") else ""
            meanings |= {term: meaning, **({sign: f"{term}: {meaning}"} if sign else {})}
    return meanings


async def static(_: Bench, request: Request) -> Response:
    """Give a script or a style sheet of ours."""
    path = STATIC.get(request.path_params["name"])
    if path is None:
        return Response(status_code=404)
    return Response(path.read_bytes(), headers=HEADERS, media_type=KINDS[path.suffix])


async def state(bench: Bench, _: Request) -> Any:
    """Give everything that the page shows."""
    return await bench.state()


async def events(bench: Bench, _: Request) -> Response:
    """Tell a page what changes, as long as it is open."""
    queue: asyncio.Queue[tuple[str, Any]] = asyncio.Queue()

    async def lines() -> AsyncIterator[str]:
        bench.listeners.add(queue)
        try:
            yield "retry: 1000\n\n"
            while True:
                try:
                    kind, content = await asyncio.wait_for(queue.get(), STILL_S)
                    yield f"event: {kind}\ndata: {json.dumps(content)}\n\n"
                    if kind == "ended":
                        return
                except TimeoutError:
                    yield ": still here\n\n"
                bench.last_seen = time.monotonic()
        finally:
            bench.listeners.discard(queue)

    return StreamingResponse(lines(), media_type="text/event-stream", headers=HEADERS)


async def upload(bench: Bench, request: Request) -> Any:
    """Take a recording in, and read it."""
    path = place_for(bench.session, request.query_params.get("name", ""))
    await received(request, path)
    if (there := same_as(bench.session, path)) is not None:
        path.unlink()
        return {**await bench.found_in(there), "already": True}
    plain = await bench.ask("read_file", path, {})
    key = bench.session.add(path, plain["form"])
    bench.told[key] = reading_stamp(path, {}), plain  # read again only where its device says how
    found = await bench.found_in(key)
    bench.say("changed", "file")
    return found


async def file(bench: Bench, request: Request) -> Any:
    """Give what was found in a file; or choose how it is read, or take it out."""
    key = request.path_params["id"]
    path = bench.session.file(key)
    if request.method == "DELETE":
        bench.session.remove(key)
    elif request.method == "PUT":
        asked = await stated(request)
        _, before = bench.told.get(key, ("", {}))
        found = await bench.ask("read_file", path, asked)
        bench.session.set_reading(key, asked, before.get("form", "") if not found["error"] else "")
    if request.method != "GET":
        bench.say("changed", "file")
    return {} if request.method == "DELETE" else await bench.found_in(key)


async def arrange(bench: Bench, request: Request) -> Any:
    """Put files into devices and devices into sets."""
    bench.session.arrange((await said(request)).get("sets", []))
    return await bench.changed()


async def describe(bench: Bench, request: Request) -> Any:
    """Take down what is known of a set or of a device."""
    key = request.path_params["id"]
    of_set = request.url.path.startswith("/api/sets/")
    (bench.session.group(key) if of_set else bench.session.device(key)[1]).describe(await said(request))
    return await bench.changed()


async def check(bench: Bench, request: Request) -> Any:
    """Say what the recordings of a device can tell, before anything is fitted."""
    key = request.path_params["id"]
    group, device = bench.session.device(key)
    return await bench.told_of(key, bench.stamp(key), "check", group.name, device.name)


async def fit(bench: Bench, request: Request) -> Any:
    """Begin the fit and the diagnosis of a device that has passed its check."""
    key = request.path_params["id"]
    group, device = bench.session.device(key)
    if not (await check(bench, request))["passed"]:
        raise CampaignError(f"{device.name} has not passed its check; the reasons stand there")
    # Alone, a fit may use all processors (0); the numbers are the same.
    threads = int(any(job.kind == "fit" for job in bench.jobs.under_way))
    return bench.begin("fit", key, group.name, device.name, threads)


async def pool(bench: Bench, _: Request) -> Any:
    """Begin population, margins and report."""
    return bench.begin("pool", "campaign", os.cpu_count() or 1)


async def end(bench: Bench, request: Request) -> Any:
    """End a job."""
    job = bench.jobs.jobs.get(request.path_params["id"])
    if job is None:
        raise CampaignError("there is no such job any more")
    bench.jobs.end(job)
    return job.told()


async def margins_asked(bench: Bench, request: Request) -> dict[str, Any]:
    """Options of the margins that a page states; a history is the one that was dropped in, whatever it says."""
    asked = await stated(request)
    for name in ("history", "drift"):
        if name in asked:
            if (path := history_in(bench.session.folder)) is None:
                raise CampaignError("no history was dropped in: choose a file of displacement (mm) over time (s)")
            asked[name] = str(path)
    return asked


async def card(bench: Bench, request: Request) -> Any:
    """Give the card of each set for what a designer asks."""
    asked = await margins_asked(bench, request)
    found = await bench.ask("card", asked)
    given = [(flag_of(MarginOptions, name), value) for name, value in asked.items()]
    words = [word for flag, value in given for word in ((flag,) if value is True else (flag, value))]
    return {**found, "command": bench.command("margins", bench.session.folder, *words)}


async def margins(bench: Bench, request: Request) -> Any:
    """Begin to draw up and write the margins for what a designer asks."""
    return bench.begin("margins", "margins", await margins_asked(bench, request))


async def history(bench: Bench, request: Request) -> Any:
    """Take a history of displacement in."""
    await received(request, place_for_history(bench.session.folder, request.query_params.get("name", "")))
    return {}


async def compare(bench: Bench, request: Request) -> Any:
    """Compare two sets."""
    asked = await said(request)
    a, b = (bench.session.group(str(asked.get(side))).name for side in ("a", "b"))
    return {**await bench.ask("compare", a, b), "command": bench.command("compare", bench.session.folder, a, b)}


async def plan(bench: Bench, request: Request) -> Any:
    """Begin to plan the next test of a device."""
    key = request.path_params["id"]
    group, device = bench.session.device(key)
    asked = await stated(request)
    try:
        limits = {name: float(asked[name]) for name in LIMITS if name in asked}
    except (TypeError, ValueError) as error:
        raise CampaignError(f"a limit of the rig is no number: {asked}") from error
    return bench.begin("plan", key, group.name, device.name, limits)


async def page(bench: Bench, request: Request) -> Response:
    """Give a page of results: one of ours as it is, any other without its scripts."""
    kind, name, root = request.path_params["of"], request.path_params["name"], bench.session.folder
    place, names = root, REPORTS
    if kind != "campaign":
        group, device = bench.session.device(kind)
        told = bench.overview["devices"]
        where = (one.get("folder") for one in told if (one["set"], one["name"]) == (group.name, device.name))
        place, names = root / (next(where, None) or "nowhere"), OF_DEVICE
    path = place / names.get(name, "nowhere")
    if not path.is_file() or not path.resolve().is_relative_to(root.resolve()):
        return Response("there is no such page (any more)\n", 404, HEADERS)
    ours = await asyncio.to_thread(is_ours, path)
    policy = "frame-ancestors 'self'" if ours else FOREIGN
    return HTMLResponse(path.read_bytes(), headers=HEADERS | {"Content-Security-Policy": policy})


async def download(bench: Bench, _: Request) -> Response:
    """Give the folder as one file."""
    handle, name = tempfile.mkstemp(suffix=".zip")
    os.close(handle)
    await asyncio.to_thread(pack, bench.session.folder, Path(name))
    gone = BackgroundTask(Path(name).unlink, missing_ok=True)
    return FileResponse(name, filename=f"{bench.session.folder.name}.zip", headers=HEADERS, background=gone)


async def story(bench: Bench, request: Request) -> Any:
    """Bring in the recordings of an example that ships with the program."""
    manifest = STORIES.get(request.path_params["name"])
    if manifest is None:
        raise CampaignError("there is no such example")
    bring(bench.session, shipped("data", "examples", manifest))
    return await bench.changed()


ROUTES = (
    ("/", "GET", front),
    ("/enter", "POST", enter),
    ("/static/{name}", "GET", static),
    ("/api/state", "GET", state),
    ("/api/events", "GET", events),
    ("/api/files", "PUT", upload),
    ("/api/files/{id}", "GET PUT DELETE", file),
    ("/api/sets", "PUT", arrange),
    ("/api/sets/{id}/about", "PUT", describe),
    ("/api/devices/{id}/about", "PUT", describe),
    ("/api/devices/{id}/check", "GET", check),
    ("/api/devices/{id}/fit", "POST", fit),
    ("/api/devices/{id}/plan", "POST", plan),
    ("/api/pool", "POST", pool),
    ("/api/jobs/{id}", "DELETE", end),
    ("/api/card", "POST", card),
    ("/api/margins", "POST", margins),
    ("/api/history", "PUT", history),
    ("/api/compare", "POST", compare),
    ("/api/download", "GET", download),
    ("/api/stories/{name}", "POST", story),
    ("/page/{of}/{name}", "GET", page),
)
