"""Many tasks in processes of this machine and on a real dask cluster, some of which die: the same numbers as alone."""

import json
import os
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

import shj_bayes
from shj_bayes._util import processes as pool
from shj_bayes.app.campaign import fit_one, run_campaign
from shj_bayes.app.manifest import Manifest, read_manifest
from shj_bayes.cli import main
from shj_bayes.errors import CampaignError
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv
from shj_bayes.results.device import read_group

distributed = pytest.importorskip("distributed", reason="the extra dask is not installed")
BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
N = 2
PATIENCE_S = 60


@pytest.fixture
def processes():
    """Start processes that end with the test."""
    started = []

    def start(part: str, *arguments: object) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", f"distributed.cli.dask_{part}", *map(str, arguments)]
        quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
        started.append(subprocess.Popen(command, **quiet))
        return started[-1]

    yield start
    for process in reversed(started):
        process.kill()
    for process in reversed(started):
        process.wait()


@pytest.fixture
def scheduler(processes, tmp_path) -> Path:
    """File with the address of a running scheduler."""
    path = tmp_path / "scheduler.json"
    processes("scheduler", "--host", "127.0.0.1", "--port", 0, "--no-dashboard", "--scheduler-file", path)
    wait_for(path.exists)
    return path


@pytest.fixture
def manifest(tmp_path) -> Manifest:
    """Two good devices and one without a displacement."""
    text = 'schema = "shj-bayes/campaign/1"\nname = "small"\ndiagnose = "off"\n'
    text += '[defaults]\nmax_steps = 200\n[[set]]\nname = "bare"\n'
    for number in range(N):
        runs = simulate_device(Truth(Fy=70.0 + 5 * number, phi=0.3), seed=number, rate_Hz=4.0, blocks=BLOCKS)
        names = [write_csv(tmp_path / f"d{number}-{i}.csv", r).name for i, r in enumerate(runs, start=1)]
        text += f'[[set.device]]\nname = "device {number}"\nrecordings = {json.dumps(names)}\n'
    (tmp_path / "broken.csv").write_text("time_s,force_kN\n1,2\n2,3\n3,4\n", encoding="utf-8")
    text += '[[set.device]]\nname = "broken"\nrecordings = ["broken.csv"]\n'
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    return read_manifest(tmp_path / "campaign.toml")


def wait_for(happened) -> None:
    end = time.monotonic() + PATIENCE_S
    while not happened():
        assert time.monotonic() < end, "waited in vain"
        time.sleep(0.05)


def worker(processes, scheduler, name):
    options = ("--nthreads", 1, "--no-nanny", "--no-dashboard", "--host", "127.0.0.1")
    return processes("worker", "--scheduler-file", scheduler, "--name", name, *options)


@pytest.mark.parametrize("again", [False, True])
def test_only_what_kills_its_process_twice_has_no_result(again, tmp_path):
    """The function and the items are such that a process that was started anew knows them."""
    flag, die = f"__import__('pathlib').Path({str(tmp_path / 'flag')!r})", "__import__('os')._exit(3)"
    deadly = die if again else f"7 if {flag}.exists() else ({flag}.touch(), {die})"
    items = ["1 + 1", deadly, "2 + 2", "3 + 3", "4 + 4"]
    found = {item: (result, reason) for item, result, reason in pool.results(2, eval, items)}
    assert [found[item][0] for item in items] == [2, None if again else 7, 4, 6, 8]
    assert [item for item in items if found[item][1]] == [deadly] * again


@pytest.mark.slow
def test_a_killed_worker_changes_nothing(processes, scheduler, manifest, tmp_path):
    victim, _ = worker(processes, scheduler, "victim"), worker(processes, scheduler, "other")
    out, lost = tmp_path / "cluster", []

    def kill_when_busy(client) -> None:
        def busy() -> bool:
            # Not in the middle of the campaign but in its first task: waiting for a finished device came too late once.
            for address in [address for address, facts in workers(client).items() if facts["name"] == "victim"]:
                lost[:] = client.processing([address]).get(address, ())
            return bool(lost)

        wait_for(busy)
        victim.kill()

    with distributed.Client(scheduler_file=str(scheduler), set_as_default=False) as client:
        wait_for(lambda: len(workers(client)) == 2)
        killer = threading.Thread(target=kill_when_busy, args=(client,))
        killer.start()
        outcomes = run_campaign(manifest, out, cluster=str(scheduler))
        killer.join()
    assert lost
    assert victim.wait() != 0
    assert [o.device for o in outcomes] == list(manifest.devices)
    # "kept": the worker was killed between finishing a device and telling so, and the next one found it finished.
    assert all(o.status in ("done", "kept") for o in outcomes[:N]), [o.reason for o in outcomes]
    assert outcomes[-1].status == "failed"
    assert "displacement" in outcomes[-1].reason
    assert not list(out.rglob("*.part"))
    for device in manifest.devices[:N]:
        assert fit_one(device, tmp_path / "alone").status == "done"
        here, there = (read_group(folder / device.folder, "posterior") for folder in (tmp_path / "alone", out))
        np.testing.assert_equal(here, there)
        assert fit_one(device, out).status == "kept"  # what the cluster wrote counts as finished here


def workers(client) -> dict[str, dict[str, object]]:
    return client.scheduler_info(n_workers=-1)["workers"]


def test_workers_that_cannot_do_it_are_named(processes, scheduler, manifest, tmp_path, monkeypatch):
    worker(processes, scheduler, "only")
    with distributed.Client(scheduler_file=str(scheduler), set_as_default=False) as client:
        client.wait_for_workers(1, timeout=PATIENCE_S)
        with pytest.raises(CampaignError, match="does not see the folder"):
            pool._check_workers(client, "here", tmp_path / "elsewhere")
    monkeypatch.setattr(shj_bayes, "__version__", "99.0")
    with pytest.raises(CampaignError, match=r"has shj-bayes .*, this is 99\.0"):
        run_campaign(manifest, tmp_path / "out", cluster=str(scheduler))


@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense://x", "no-such-file.json"])
def test_an_address_that_does_not_answer_is_said(address, manifest, tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "PATIENCE_S", 0.5)
    with pytest.raises(CampaignError) as error:
        run_campaign(manifest, tmp_path / "out", cluster=address)
    assert address in str(error.value)
    assert "dask scheduler" in str(error.value)


@pytest.mark.parametrize("kind", ["silent", "pipe", "no address"])
def test_what_never_answers_is_left_after_the_deadline(kind, manifest, tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "PATIENCE_S", 1)
    path = tmp_path / "s.json"
    with socket.create_server(("127.0.0.1", 0)) as server:
        if kind == "pipe":
            os.mkfifo(path)
        path.write_text("[]", encoding="utf-8") if kind == "no address" else None
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}" if kind == "silent" else str(path)
        words = {"silent": "no dask scheduler answers there within 1 s", "pipe": "not an ordinary file"}
        begin = time.monotonic()
        with pytest.raises(CampaignError, match=words.get(kind, "names no address")):
            run_campaign(manifest, tmp_path / "out", cluster=address)
    assert time.monotonic() - begin < 5
    assert not [thread for thread in threading.enumerate() if "IO loop" in thread.name]


def test_without_the_extra_it_says_what_to_install(manifest, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(CampaignError, match=r"pip install 'shj-bayes\[dask\]'"):
        run_campaign(manifest, tmp_path / "out", cluster="tcp://127.0.0.1:9")


def test_workers_and_dask_exclude_each_other(tmp_path):
    done = CliRunner().invoke(main, ["campaign", "m.toml", "-o", str(tmp_path), "--workers", "2", "--dask", "x:1"])
    assert done.exit_code == 2
    assert "give one of them" in done.output
