"""A bench on a small folder, served as a user would have it, and a client that knows the way in."""

import http.client
import json
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlparse

from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv

SMALL = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2), Block(24.0, 0.025, 1))


def write_device(folder: Path, name: str, *, seed: int, Fy: float = 80.0) -> list[Path]:
    """Two runs of a small simulated device."""
    truth = Truth(K=18.0, Fy=Fy, beta=10.0, gamma=0.01, ratio=0.85, sigma=0.6)
    runs = simulate_device(truth, seed=seed, rate_Hz=6.0, blocks=SMALL)
    return [write_csv(folder / f"{name}-run{i}.csv", run) for i, run in enumerate(runs, start=1)]


@dataclass(eq=False)
class Served:
    """A bench that runs."""

    folder: Path
    process: "subprocess.Popen[str]"
    way_in: Path
    port: int
    token: str
    cookie: str = ""

    @classmethod
    def on(cls, folder: Path) -> "Served":
        """Begin a bench on a folder."""
        command = [sys.executable, "-m", "shj_bayes", "bench", str(folder), "--no-browser"]
        process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
        assert process.stdout is not None
        line = process.stdout.readline()
        assert line.startswith("bench: file:"), line + process.stdout.read()
        way_in = Path(unquote(urlparse(line.split(": ", 1)[1].strip()).path))
        page = way_in.read_text(encoding="utf-8")
        port, token = re.search(r"127\.0\.0\.1:(\d+)/enter", page), re.search(r'value="([0-9a-f]{64})"', page)
        assert port
        assert token
        return cls(folder, process, way_in, int(port[1]), token[1])

    @property
    def host(self) -> str:
        """Host of its address."""
        return f"127.0.0.1:{self.port}"

    def enter(self) -> None:
        """Get the cookie as a browser does."""
        body = f"token={self.token}\r\n"
        status, headers, _ = self.raw("POST", "/enter", body.encode(), {"Origin": "null", "Host": self.host})
        assert status == 200
        self.cookie = headers["set-cookie"].split(";")[0]

    def raw(
        self, method: str, path: str, body: bytes | None = None, headers: dict[str, str] | None = None
    ) -> tuple[int, dict[str, str], bytes]:
        """Send a request as it is."""
        connection = http.client.HTTPConnection("127.0.0.1", self.port, timeout=60)
        try:
            connection.putrequest(method, path, skip_host=True, skip_accept_encoding=True)
            for name, value in (headers or {}).items():
                connection.putheader(name, value)
            if body is not None and "Content-Length" not in (headers or {}):
                connection.putheader("Content-Length", str(len(body)))
            connection.endheaders(body)
            answer = connection.getresponse()
            return answer.status, {k.lower(): v for k, v in answer.getheaders()}, answer.read()
        finally:
            connection.close()

    def ask(self, method: str, path: str, content: Any = None, **more: str) -> tuple[int, Any]:
        """Ask as our page does."""
        body = content if isinstance(content, bytes) or content is None else json.dumps(content).encode()
        headers = {"Host": self.host, "Origin": f"http://{self.host}", "Cookie": self.cookie} | more
        status, kind, answer = self.raw(method, path, body, headers)
        return status, json.loads(answer) if "json" in kind.get("content-type", "") else answer

    def end(self) -> str:
        """End it by Ctrl-C's signal, and give what it said."""
        self.process.send_signal(2)
        out, _ = self.process.communicate(timeout=30)
        return out
