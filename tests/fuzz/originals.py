"""Good files of every kind that the tool reads; the corpus is made of them by damage."""

from __future__ import annotations

import gzip
import io
import json
from pathlib import Path

import h5py
import numpy as np
import openpyxl
import scipy.io
from nptdms import ChannelObject, TdmsWriter

from shj_bayes._util.arrays import FloatArray
from shj_bayes._util.files import shipped
from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.fit import fit
from shj_bayes.inference.sampler import SamplingPlan
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.population.device import published_devices
from shj_bayes.population.hierarchy import fit_population
from shj_bayes.population.results import write_population
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import Recording

BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2))
TRUTH = Truth(sigma=0.5, phi=0.3)

MANIFEST = """schema = "shj-bayes/campaign/1"
name = "Spring tests"
simulated = true

[defaults]
columns = "displacement=displacement_mm,force=force_kN"
units = "s,mm,kN"
priors = "afc"
noise = "ar1"
free = ["gamma"]
max_steps = 400
seed = 7

[[set]]
name = "Zinc 70"
options = {rate_Hz = 100.0}

[[set.device]]
name = "Z70-1"
recordings = ["z70-1-run1.csv", "z70-1-run2.csv"]

[[set.device]]
name = "Z70-2"
recordings = ["z70-2-run1.csv"]
options = {seed = 3, priors = "general"}

[[set]]
name = "Bare"

[[set.device]]
name = "B-1"
recordings = ["b-1.xlsx"]
"""


LVM = """LabVIEW Measurement
Separator\tTab
***End_of_Header***
Channels\t2\t\t
Date\t2024/05/03\t2024/05/03
Time\t10:00:00,5\t10:00:00,5
Y_Unit_Label\tmm\tkN
X0\t0.0\t0.0
Delta_X\t0.05\t0.05
***End_of_Header***\t\t\t
"""


def recording(seed: int = 1, rate_Hz: float = 6.0) -> Recording:
    """About 270 samples with two amplitudes."""
    return simulate_device(TRUTH, seed=seed, rate_Hz=rate_Hz, blocks=BLOCKS)[0]


def rows_of(one: Recording) -> list[list[float]]:
    """Rows of time, displacement and force, rounded as a data logger prints them."""
    table = np.column_stack([one.time_s, one.displacement_mm, one.force_kN])
    return [[float(f"{value:.6g}") for value in row] for row in table.tolist()]


def text(rows: list[list[float]], separator: str = ",", decimal: str = ".", head: str = "") -> str:
    """Rows as a text table."""
    head = head or separator.join(("time_s", "displacement_mm", "force_kN"))
    lines = [separator.join(repr(value).replace(".", decimal) for value in row) for row in rows]
    return "\n".join([head, *lines]) + "\n"


def recordings(folder: Path) -> dict[str, bytes]:
    """One recording in every format, by file name."""
    rows = rows_of(recording())
    columns = dict(zip(("time_s", "displacement_mm", "force_kN"), np.array(rows).T, strict=True))
    preamble = "Prüfung 7, n°3\nOperator: A. B.\n"
    files = {
        "comma.csv": text(rows).encode(),
        "tab.tsv": text(rows, "\t", head="Time\tDisplacement\tForce\n(s)\t(mm)\t(kN)").encode(),
        "semicolon.csv": (preamble + text(rows, ";", ",", "Zeit [s];Weg [mm];Kraft [kN]")).encode("cp1252"),
        "blanks.txt": (text(rows, "  ") + "End of test\nchecked by C. D.\n").encode(),
        "wide.csv": text(rows).encode("utf-16"),
        "packed.csv.gz": gzip.compress(text(rows).encode(), mtime=0),
        "letters.csv.gz": gzip.compress(b"a " * 32_767 + b"\n" + b"\n".join([b"a," * 32_767] * 399), mtime=0),
        "heads.dat": "".join(
            text(rows[k : k + 40], "\t", head=f"Cycle {k}\nTime\tDisplacement\tForce\nSec\tmm\tkN")
            for k in range(0, len(rows), 40)
        ).encode(),
        "wave.lvm": (LVM + text(rows, "\t", head="X_Value\tDisplacement\tForce\tComment")).encode(),
        "stamps.csv": "\n".join(
            ["Date,Time,Stroke (in),Load (kip)"]
            + [f"5/3/2024,23:59:{a % 60:06.3f},{b},\u2212{c}" for a, b, c in rows if 0 <= a < 60]
        ).encode(),
    }
    book = openpyxl.Workbook()
    book.active.append(["Time (s)", "Displacement (mm)", "Force (kN)"])
    for row in rows:
        book.active.append(row)
    stream = io.BytesIO()
    book.save(stream)
    files["book.xlsx"] = stream.getvalue()
    for name, compressed in (("plain.mat", False), ("small.mat", True)):
        scipy.io.savemat(folder / name, columns, do_compression=compressed)
        files[name] = (folder / name).read_bytes()
    for name in ("data.h5", "seven.mat"):
        with h5py.File(folder / name, "w") as file:
            for key, values in columns.items():
                file.create_dataset(key, data=values, compression="gzip" if name == "data.h5" else None)
            file["force_kN"].attrs["units"] = "kN"
        files[name] = (folder / name).read_bytes()
    with TdmsWriter(folder / "labview.tdms") as writer:
        channels = [ChannelObject("test", key, values) for key, values in columns.items()]
        writer.write_segment(channels)
    files["labview.tdms"] = (folder / "labview.tdms").read_bytes()
    return files | _nested(folder, columns)


def _nested(folder: Path, columns: dict[str, FloatArray]) -> dict[str, bytes]:
    """The same in structs, groups, sheets, and as pandas writes it."""
    files = {
        "split.json": json.dumps({"columns": list(columns), "data": np.transpose(list(columns.values())).tolist()})
    }
    by_index = {name: dict(enumerate(values.tolist())) for name, values in columns.items()}
    files["columns.json"] = json.dumps(by_index)
    packed = {name: content.encode() for name, content in files.items()}
    time_s, *channels = columns.values()
    pairs = {name: {"Time": time_s, "Data": values} for name, values in zip(("disp", "force"), channels, strict=True)}
    scipy.io.savemat(folder / "nested.mat", {"test": {"name": "A", "data": pairs}}, do_compression=True)
    packed["nested.mat"] = (folder / "nested.mat").read_bytes()
    with TdmsWriter(folder / "groups.tdms") as writer:
        for run in ("Run 1", "Run 2"):
            steps = {"wf_increment": 0.1, "wf_start_offset": 0.0}
            writer.write_segment([ChannelObject(run, k, v, properties=steps) for k, v in list(columns.items())[1:]])
    packed["groups.tdms"] = (folder / "groups.tdms").read_bytes()
    book = openpyxl.Workbook()
    book.active.append(["Cycle", "Max force (kN)"])
    book.active.append([1, 80.0])
    sheet = book.create_sheet("Data")
    sheet.append(list(columns))
    for row in np.transpose(list(columns.values())).tolist():
        sheet.append(row)
    stream = io.BytesIO()
    book.save(stream)
    return packed | {"two.xlsx": stream.getvalue()}


def settings() -> dict[str, bytes]:
    """A manifest and the prior files that ship."""
    priors = {path.name: path.read_bytes() for path in sorted(shipped("priors").glob("*.toml"))}
    return {"campaign.toml": MANIFEST.encode(), **priors}


def results(folder: Path) -> dict[str, bytes]:
    """The files of a tiny finished fit, of a campaign and of a population, by file name."""
    device = folder / "devices" / "one"
    runs = simulate_device(TRUTH, seed=1, rate_Hz=4.0, blocks=BLOCKS)
    model = DeviceModel(2, read_priors())
    fit(runs_of(runs), model, name="one", plan=SamplingPlan(max_steps=50, round_steps=50), folder=device)
    write_population(fit_population(published_devices()[:6], seed=1), folder)
    entry = {"name": "one", "folder": "devices/one", "status": "done", "reason": "", "verdict": "tentative"}
    record = {"schema": "shj-bayes/campaign/1", "name": "small", "simulated": True}
    record |= {"sets": [{"name": "bare", "devices": [entry]}]}
    (folder / "campaign.json").write_text(json.dumps(record), encoding="utf-8")
    return {str(p.relative_to(folder)): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}
