"""Nobody else gets in: pages of other origins, other hosts, old tokens, paths, sizes, floods."""

import asyncio
import http.client
import os
import socket
import stat
import subprocess
import sys
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any
from urllib.parse import quote

import pytest
from serving import Served, write_device
from starlette.requests import Request

from shj_bayes.bench import routes
from shj_bayes.errors import CampaignError


def refused(served: Served, method: str = "GET", path: str = "/api/state", **headers: str) -> bytes:
    """Words of a refusal; every one has no cookie and no content."""
    given = {"Host": served.host, "Cookie": served.cookie} | {k.replace("_", "-"): v for k, v in headers.items()}
    status, answered, body = served.raw(method, path, b"" if method != "GET" else None, given)
    assert status == 403
    assert "set-cookie" not in answered
    assert answered["x-content-type-options"] == "nosniff"
    return body


def test_our_page_is_let_in(served: Served) -> None:
    status, state = served.ask("GET", "/api/state")
    assert status == 200
    assert state["folder"] == "spring series"


@pytest.mark.parametrize(
    "path", ["/", "/api/state", "/api/events", "/static/bench.js", "/page/campaign/report", "/nowhere"]
)
def test_other_hosts_origins_and_sites_are_refused_on_every_route(served: Served, path: str) -> None:
    for host in ("evil.example", f"evil.example:{served.port}", "127.0.0.1", f"localhost:{served.port}", ""):
        assert b"another host" in refused(served, path=path, Host=host)
    for origin in ("http://evil.example", "null", f"https://{served.host}", f"http://127.0.0.1:{served.port + 1}"):
        assert b"another origin" in refused(served, path=path, Origin=origin)
    for site in ("cross-site", "same-site"):
        assert b"another site" in refused(served, path=path, Sec_Fetch_Site=site)


@pytest.mark.parametrize("cookie", ["", "shj_bench_1=x", "shj_bench_{port}=", "shj_bench_{port}=" + 64 * "0"])
def test_without_the_token_nothing_is_told(served: Served, cookie: str) -> None:
    assert b"no token" in refused(served, Cookie=cookie.format(port=served.port))


def test_forms_and_fetches_of_other_pages_change_nothing(served: Served) -> None:
    """A form sends cookies that are not strict, and no header of ours: it has another origin, or none."""
    for method, path in (("POST", "/api/pool"), ("PUT", "/api/sets"), ("DELETE", "/api/files/f1")):
        assert b"no origin" in refused(served, method, path)
        assert b"another origin" in refused(served, method, path, Origin="http://evil.example")
        assert b"another origin" in refused(served, method, path, Origin="null")


def test_an_old_token_and_other_ways_in_are_refused(served: Served) -> None:
    given = {"Host": served.host, "Origin": "null"}
    status, headers, body = served.raw("POST", "/enter", b"token=" + 64 * b"0", given)
    assert (status, "set-cookie" in headers) == (403, False)
    assert b"old token" in body
    for method, origin in (("GET", "null"), ("POST", "http://evil.example"), ("POST", f"http://{served.host}")):
        assert b"not the way in" in refused(served, method, "/enter", Origin=origin)


def test_cookie_and_pages_carry_what_keeps_others_out(served: Served) -> None:
    body = f"token={served.token}".encode()
    _, headers, _ = served.raw("POST", "/enter", body, {"Host": served.host, "Origin": "null"})
    assert {"HttpOnly", "SameSite=strict"} <= {part.strip() for part in headers["set-cookie"].split(";")}
    _, headers, page = served.raw("GET", "/", None, {"Host": served.host, "Cookie": served.cookie})
    policy = headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert served.token.encode() not in page
    assert headers["cache-control"] == "no-store"


@pytest.mark.skipif(sys.platform == "win32", reason="rights are told otherwise there")
def test_the_token_lies_in_a_file_of_this_user_alone_and_in_no_list_of_processes(served: Served) -> None:
    assert stat.S_IMODE(served.way_in.stat().st_mode) == 0o600
    assert stat.S_IMODE(served.way_in.parent.stat().st_mode) == 0o700
    told = Path(f"/proc/{served.process.pid}")
    if told.exists():
        assert served.token.encode() not in (told / "cmdline").read_bytes() + (told / "environ").read_bytes()


def test_websockets_are_refused(served: Served) -> None:
    upgrade = {"Upgrade": "websocket", "Connection": "Upgrade", "Sec-WebSocket-Key": 22 * "A" + "=="}
    given = {"Host": served.host, "Origin": "http://evil.example", "Sec-WebSocket-Version": "13", **upgrade}
    status, _, _ = served.raw("GET", "/api/events", None, given)
    assert status in (400, 403)


PATHS = [
    "../../etc/passwd",
    "..%2f..%2fetc%2fpasswd",
    "%2e%2e/%2e%2e",
    "/etc/passwd",
    "C:%5cWindows",
    "f1%00",
    "<script>",
]


@pytest.mark.parametrize("bad", PATHS)
def test_no_parameter_is_a_path(served: Served, bad: str) -> None:
    plan: list[tuple[str, str, Any]] = [
        ("GET", f"/api/files/{bad}", None),
        ("PUT", f"/api/files/{bad}", {"columns": "time=1"}),
        ("DELETE", f"/api/files/{bad}", None),
        ("GET", f"/api/devices/{bad}/check", None),
        ("POST", f"/api/devices/{bad}/fit", None),
        ("POST", f"/api/stories/{bad}", None),
        ("PUT", f"/api/sets/{bad}/about", {"note": "x"}),
        ("GET", f"/page/{bad}/report", None),
        ("GET", f"/page/campaign/{bad}", None),
        ("GET", f"/static/{bad}", None),
        ("PUT", "/api/sets", {"sets": [{"name": "a", "devices": [{"name": "b", "files": [bad]}]}]}),
        ("POST", "/api/compare", {"a": bad, "b": bad}),
        ("POST", "/api/card", {"history": bad}),
    ]
    for method, path, content in plan:
        status, answer = served.ask(method, path, content)
        assert status in (404, 405, 413) or "refused" in answer, (method, path, answer)
        assert b"root:" not in str(answer).encode()


@pytest.mark.parametrize(
    "name",
    [
        "../../evil.csv",
        "..\\..\\evil.csv",
        "/etc/evil.csv",
        "a/../../evil.csv",
        "C:\\evil.csv",
        ".bashrc",
        "<img src=x onerror=alert(1)>.csv",
        "\u202evsc.exe",
        "a\x1b[31m.csv",
        "",
        "NUL",
        300 * "x" + ".csv",
    ],
)
def test_a_name_is_a_name_and_stays_in_the_folder(served: Served, name: str) -> None:
    before = set(served.folder.parent.rglob("*"))
    status, found = served.ask("PUT", f"/api/files?name={quote(name)}", b"time_s,displacement_mm,force_kN\n0,1,2\n")
    assert status == 200
    new = set(served.folder.parent.rglob("*")) - before
    kept = [path for path in new if path.is_file() and path.parent.name == "recordings"]
    assert len(kept) == 1
    assert {path.parent for path in new if path.is_file()} <= {
        served.folder,
        served.folder / "recordings",
        served.folder / "bench",
    }
    assert not kept[0].name.startswith(".")
    assert kept[0].name.isprintable()
    assert "<" not in kept[0].name
    assert served.ask("DELETE", f"/api/files/{found['id']}")[0] == 200
    assert not kept[0].exists()


def test_ten_gigabytes_are_refused_before_they_are_sent(served: Served) -> None:
    status, answer = served.ask("PUT", "/api/files?name=big.csv", b"", **{"Content-Length": str(10 * 1024**3)})
    assert status == 413
    assert "512 MiB" in answer["refused"]
    assert served.ask("PUT", "/api/sets", b" " * 1_000_001)[0] == 413
    assert not list((served.folder / "recordings").glob("*.part"))


def request_of(parts: list[bytes], length: int = 0) -> Request:
    """A request whose body comes in parts."""
    coming = iter(parts)

    async def receive() -> dict[str, Any]:
        part = next(coming, None)
        return {"type": "http.request", "body": part or b"", "more_body": part is not None}

    headers = [(b"content-length", str(length).encode())] if length else []
    return Request({"type": "http", "method": "PUT", "headers": headers, "path": "/", "query_string": b""}, receive)


async def whole(stream: AsyncIterator[bytes]) -> bytes:
    return b"".join([part async for part in stream])


def test_a_body_that_says_it_is_short_and_is_not_is_cut_off() -> None:
    assert asyncio.run(whole(routes.body_of(request_of([b"ab", b"c"]), 10))) == b"abc"
    with pytest.raises(CampaignError, match="more than"):
        asyncio.run(whole(routes.body_of(request_of([b"x" * 6, b"x" * 6], 6), 10)))


def test_a_slow_upload_is_ended(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(routes, "SLOWEST_S", 0.05)

    async def receive() -> dict[str, Any]:
        await asyncio.sleep(0.03)
        return {"type": "http.request", "body": b"x", "more_body": True}

    async def never() -> dict[str, Any]:
        await asyncio.sleep(10)
        return {}

    scope = {"type": "http", "method": "PUT", "headers": [], "path": "/", "query_string": b""}
    with pytest.raises(CampaignError, match="too slow"):
        asyncio.run(whole(routes.body_of(Request(scope, receive), 10_000)))
    with pytest.raises(CampaignError, match="stood still"):
        asyncio.run(whole(routes.body_of(Request(scope, never), 10_000)))


@pytest.mark.parametrize(
    "body", [b"{", b"[]", b"[" * 100_000, b"\xff", b'{"sets": 3}', b'{"sets": [3]}', b'{"sets": [{}]}']
)
def test_nonsense_is_refused_in_words(served: Served, body: bytes) -> None:
    status, answer = served.ask("PUT", "/api/sets", body)
    assert status in (200, 413)
    assert "unexpected" not in answer["refused"]


def test_a_thousand_connections_do_not_end_it(served: Served) -> None:
    flood = []
    try:
        for _ in range(1000):
            one = socket.create_connection(("127.0.0.1", served.port), timeout=10)
            flood.append(one)
    except OSError:
        assert len(flood) > 100
    finally:
        for one in flood:
            one.close()
    for _ in range(50):
        try:
            if served.ask("GET", "/static/bench.js")[0] == 200:
                break
        except (http.client.HTTPException, OSError):
            pass
    assert served.ask("GET", "/api/state")[0] == 200


def test_a_second_bench_on_the_folder_is_refused_in_words(served: Served) -> None:
    command = [sys.executable, "-m", "shj_bayes", "bench", str(served.folder), "--no-browser"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert done.returncode == 1
    assert "a bench is open on spring series already" in done.stderr
    assert "Traceback" not in done.stderr


def test_a_report_that_is_not_ours_runs_no_script(served: Served, tmp_path: Path) -> None:
    (served.folder / "report.html").write_text("<script>parent.document.title = 'taken'</script>", encoding="utf-8")
    status, headers, _ = served.raw(
        "GET", "/page/campaign/report", None, {"Host": served.host, "Cookie": served.cookie}
    )
    assert status == 200
    assert headers["content-security-policy"].startswith("sandbox; default-src 'none'")
    (served.folder / "report.html").unlink()
    secret = tmp_path / "secret.html"
    secret.write_text("secret", encoding="utf-8")
    try:
        os.symlink(secret, served.folder / "report.html")
    except OSError:
        pytest.skip("no links here")
    assert served.raw("GET", "/page/campaign/report", None, {"Host": served.host, "Cookie": served.cookie})[0] == 404
    (served.folder / "report.html").unlink()


def test_names_with_markup_are_text_in_the_manifest(served: Served, tmp_path: Path) -> None:
    file = write_device(tmp_path, "x", seed=1)[0]
    status, found = served.ask("PUT", "/api/files?name=x.csv", file.read_bytes())
    assert (status, found["usable"]) == (200, True)
    name = '</script><img src=x onerror="alert(1)">\n[[set]]"""'
    sets = [{"name": name, "devices": [{"name": name, "files": [found["id"]]}]}]
    status, state = served.ask("PUT", "/api/sets", {"sets": sets})
    assert status == 200
    assert state["error"] == ""
    assert len(state["sets"]) == 1
    assert state["sets"][0]["devices"][0]["name"].startswith("</script>")
    page = served.ask("GET", "/")[1]
    assert b"onerror" not in page
    assert served.ask("DELETE", f"/api/files/{found['id']}")[0] == 200
