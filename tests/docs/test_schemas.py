"""Files of results are what their JSON Schemas in docs/schemas say."""

import importlib.util
import json
from pathlib import Path
from typing import Any

import pytest

import shj_bayes
from shj_bayes.model.simulate import Truth, simulate_device
from shj_bayes.recording.motion import Block
from shj_bayes.recording.recording import write_csv
from shj_bayes.results.diagnosis import LeftOver
from shj_bayes.results.store import DIAGNOSIS, find

jsonschema = pytest.importorskip("jsonschema", reason="jsonschema is not installed")
SCHEMAS = Path(__file__).resolve().parents[2] / "docs" / "schemas"
BLOCKS = (Block(12.0, 0.13, 2), Block(24.0, 0.067, 2), Block(48.0, 0.034, 2))


def schema(name: str) -> dict[str, Any]:
    return dict(json.loads((SCHEMAS / f"{name}.schema.json").read_text(encoding="utf-8")))


def check(file: Path) -> None:
    jsonschema.Draft202012Validator(schema(file.stem)).validate(json.loads(file.read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory, brief_workbooks: None) -> Path:
    folder = tmp_path_factory.mktemp("files")
    made = simulate_device(Truth(gamma=1 / 60), seed=3, rate_Hz=3.0, blocks=BLOCKS)
    runs = [write_csv(folder / f"a-run{i}.csv", run).name for i, run in enumerate(made, start=1)]
    text = 'schema = "shj-bayes/campaign/1"\nname = "c"\n[defaults]\nmax_steps = 200\n[[set]]\nname = "s"\n'
    text += '[set.connection]\nbolts = 2\ndisplacement = "machine"\n'
    text += f'[[set.device]]\nname = "d"\nrecordings = {json.dumps(runs)}\n'
    text += '[[set.device]]\nname = "gone"\nrecordings = ["gone.csv"]\n'
    (folder / "c.toml").write_text(text, encoding="utf-8")
    shj_bayes.Campaign.read(folder / "c.toml").run(folder / "out", workers=1)
    device = next(p.parent for p in (folder / "out").glob("devices/*/fit.json"))
    shj_bayes.plan([device, device], folder / "next", question="force")
    return folder


def test_schemas_are_those_of_the_records() -> None:
    """`python docs/schemas/make.py` writes them anew."""
    spec = importlib.util.spec_from_file_location("schemas_make", SCHEMAS / "make.py")
    assert spec is not None
    assert spec.loader is not None
    make = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(make)
    assert {p.name: p.read_text(encoding="utf-8") for p in SCHEMAS.glob("*.json")} == make.texts()


@pytest.mark.parametrize("path", sorted(SCHEMAS.glob("*.json")), ids=lambda p: p.stem)
def test_schemas_are_sound_and_refuse_nothing_in_particular(path: Path) -> None:
    found = schema(path.name.partition(".")[0])
    jsonschema.Draft202012Validator.check_schema(found)
    assert list(jsonschema.Draft202012Validator(found).iter_errors({}))


def test_fresh_files_are_as_described(results: Path) -> None:
    device = next(p.parent for p in (results / "out").glob("devices/*/fit.json"))
    assert find(LeftOver, device)
    files = [device / f"{name}.json" for name in ("fit", "summary", "residual")]
    files += [
        results / "out" / "campaign.json",
        results / "out" / "population.json",
        results / "out" / "margins.json",
        device / DIAGNOSIS / "diagnosis.json",
        results / "next" / "plan.json",
    ]
    assert {file.stem for file in files} == {p.name.partition(".")[0] for p in SCHEMAS.glob("*.json")}
    for file in files:
        check(file)


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("fit", {"verdict": "splendid"}),
        ("diagnosis", {"p_value": 1.5}),
        ("campaign", {"sets": [{"name": "s"}]}),
        ("summary", {"parameters": []}),
    ],
)
def test_wrong_files_are_refused(results: Path, name: str, change: dict[str, Any]) -> None:
    device = next(p.parent for p in (results / "out").glob("devices/*/fit.json"))
    place = {"diagnosis": device / DIAGNOSIS, "campaign": results / "out"}.get(name, device)
    content = json.loads((place / f"{name}.json").read_text(encoding="utf-8")) | change
    assert list(jsonschema.Draft202012Validator(schema(name)).iter_errors(content))
