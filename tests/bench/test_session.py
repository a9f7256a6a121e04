"""The folder of a bench is an ordinary campaign folder; it goes into one file and comes back out of it."""

import json
import zipfile
from collections.abc import Callable
from pathlib import Path

import pytest
from serving import write_device

from shj_bayes.app.manifest import read_manifest
from shj_bayes.bench import archive, server
from shj_bayes.bench.session import HEAD, KEPT, Session, bring, place_for, reading_of
from shj_bayes.errors import CampaignError


def session_with(folder: Path, *names: str) -> Session:
    """A session whose files came in under these names."""
    session = Session(folder)
    for name in names:
        path = place_for(session, name)
        path.write_text("time_s,displacement_mm,force_kN\n0,0,0\n", encoding="utf-8")
        session.add(path)
    return session


def layout(session: Session) -> dict[str, dict[str, list[str]]]:
    """Sets, devices and names of files."""
    return {s.name: {d.name: [session.files[k].name for k in d.files] for d in s.devices} for s in session.sets}


def test_names_of_files_arrange_runs_devices_and_sets(tmp_path: Path) -> None:
    names = ("bare-1-run2.csv", "bare-1-run1.csv", "bare-2 Run 1.xlsx", "zinc_1_r1.csv.gz", "alone.mat", "s24.csv")
    session = session_with(tmp_path, *names)
    assert layout(session) == {
        "bare": {"bare-1": ["bare-1-run1.csv", "bare-1-run2.csv"], "bare-2": ["bare-2 Run 1.xlsx"]},
        "zinc": {"zinc_1": ["zinc_1_r1.csv.gz"]},
        "Set 1": {"alone": ["alone.mat"], "s24": ["s24.csv"]},
    }
    assert layout(Session(tmp_path)) == layout(session)


def test_the_commands_read_the_manifest(tmp_path: Path) -> None:
    session = session_with(tmp_path, "a-1.csv", "a-2.csv")
    key = session.sets[0].devices[0].files[0]
    session.set_reading(key, {"columns": "time=1,displacement=2,force=3", "units": "time=ms", "runs": "one"})
    session.sets[0].describe({"connection": {"bolts": "2", "slot_mm": 220, "shim": ""}, "note": 'a "b"\n\\'})
    session.sets[0].devices[1].describe({"note": "second", "options": {"model": "continuous"}})
    session.write()
    first, second = read_manifest(tmp_path / "campaign.toml").devices
    assert (first.options.columns, first.options.runs) == ("time=1,displacement=2,force=3", "one")
    assert first.set_note == 'a "b"\n\\'
    assert (second.note, second.options.model) == ("second", "continuous")
    assert first.connection is not None
    assert (first.connection.bolts, first.connection.slot_mm, first.connection.shim) == (2, 220.0, None)


def test_arranging_moves_renames_and_refuses(tmp_path: Path) -> None:
    session = session_with(tmp_path, "a-1.csv", "a-2.csv", "b-1.csv")
    a, b = session.sets
    one, two = a.devices
    session.arrange(
        [
            {"id": b.id, "name": "zinc", "devices": [{"id": two.id, "name": "z2", "files": [*two.files, *one.files]}]},
            {"name": "new", "devices": [{"name": "n1", "files": b.devices[0].files}]},
        ]
    )
    assert layout(session) == {"zinc": {"z2": ["a-2.csv", "a-1.csv"]}, "new": {"n1": ["b-1.csv"]}}
    before = (tmp_path / "campaign.toml").read_bytes()
    key = b.devices[0].files[0]
    same = {"name": "x", "devices": [{"name": "y", "files": [key]}, {"name": "y", "files": ["f1"]}]}
    for wanted, why in (
        ([same], "called 'y'"),
        ([{"name": "x", "devices": [{"name": "y", "files": ["nothing"]}]}], "no file"),
        ([{"name": "x", "devices": [{"name": "y", "files": [key, key]}]}], "one device alone"),
        ([{"name": "x", "devices": []}, {"name": "x", "devices": []}], "same name"),
    ):
        with pytest.raises(CampaignError, match=why):
            session.arrange(wanted)
        session.write()  # a refusal leaves nothing of it behind
        assert (tmp_path / "campaign.toml").read_bytes() == before


def test_columns_that_were_chosen_are_chosen_for_files_of_the_same_form(tmp_path: Path) -> None:
    session = session_with(tmp_path, "a.txt")
    session.set_reading("f1", {"units": "mm,kN,s"}, form="abc")
    again = Session(tmp_path)
    path = place_for(again, "b.txt")
    path.write_text("x", encoding="utf-8")
    assert reading_of(again, again.add(path, "abc")) == {"units": "mm,kN,s"}


def test_a_manifest_made_by_hand_is_kept_with_all_that_it_says(tmp_path: Path) -> None:
    write_device(tmp_path, "a", seed=1)
    text = (
        '# mine\nschema = "shj-bayes/campaign/1"\nname = "By hand"\ndiagnose = "full"\n[defaults]\nnoise = "ar1"\n'
        '[[set]]\nname = "S"\ncoating = "zinc"\n[set.options]\nfree = ["K"]\n[[set.device]]\nname = "D"\n'
        'recordings = ["a-run1.csv", "a-run2.csv"]\nrun'
        "s = 2\n"
    )
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    before = read_manifest(tmp_path / "campaign.toml")
    session = Session(tmp_path)
    session.sets[0].devices[0].describe({"note": ""})
    session.write()
    assert read_manifest(tmp_path / "campaign.toml") == before
    assert (tmp_path / KEPT).read_text(encoding="utf-8") == text
    assert (tmp_path / "campaign.toml").read_text(encoding="utf-8").startswith(HEAD)


@pytest.mark.parametrize("text", ["[[set", "set = 3", "[[set]]\nname = 3", "[[set]]\n[[set.device]]\nname = 'x'"])
def test_a_manifest_that_is_none_is_told(tmp_path: Path, text: str) -> None:
    (tmp_path / "campaign.toml").write_text(text, encoding="utf-8")
    if text.endswith("= 3") and "[[" in text:
        assert Session(tmp_path).sets[0].name == "3"
        return
    with pytest.raises(CampaignError, match=r"campaign.toml in .* mend it"):
        Session(tmp_path)


def test_a_folder_goes_into_one_file_and_back(tmp_path: Path) -> None:
    session = session_with(tmp_path / "bench", "a-1.csv")
    session.sets[0].describe({"note": "kept"})
    session.write()
    (tmp_path / "bench" / "checkpoint.h5").write_bytes(b"under way")
    target = tmp_path / "out.zip"
    archive.pack(tmp_path / "bench", target)
    crate = json.loads(zipfile.ZipFile(target).read(archive.CRATE))
    root = next(one for one in crate["@graph"] if one["@id"] == "./")
    assert {part["@id"] for part in root["hasPart"]} == {"campaign.toml", "recordings/a-1.csv", "bench/memory.json"}
    archive.unpack(target, tmp_path / "again")
    assert layout(Session(tmp_path / "again")) == layout(session)
    assert Session(tmp_path / "again").sets[0].content["note"] == "kept"
    with pytest.raises(CampaignError, match="not empty"):
        archive.unpack(target, tmp_path / "again")


def _entry(name: str, content: bytes = b"x", mode: int = 0o100644) -> Callable[[zipfile.ZipFile], None]:
    def add(target: zipfile.ZipFile) -> None:
        info = zipfile.ZipInfo(name)
        info.external_attr = mode << 16
        info.compress_type = zipfile.ZIP_DEFLATED
        target.writestr(info, content)

    return add


HOSTILE = {
    "up": _entry("../evil.txt"),
    "within": _entry("a/../../evil.txt"),
    "root": _entry("/evil.txt"),
    "drive": _entry("C:/evil.txt"),
    "backslash": _entry("..\\evil.txt"),
    "link": _entry("link", b"/etc/passwd", 0o120777),
    "pipe": _entry("pipe", b"", 0o010644),
    "bomb": _entry("zeros.csv", bytes(50_000_000)),
    "more": _entry("not-named.txt"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_a_hostile_file_is_refused_whole(tmp_path: Path, kind: str) -> None:
    session_with(tmp_path / "bench", "a-1.csv")
    target = tmp_path / "in.zip"
    archive.pack(tmp_path / "bench", target)
    with zipfile.ZipFile(target, "a") as changed:
        HOSTILE[kind](changed)
    with pytest.raises(CampaignError, match=r"in\.zip"):
        archive.unpack(target, tmp_path / "new")
    assert not (tmp_path / "new").exists()
    assert not list(tmp_path.rglob("evil*"))


def test_a_file_that_was_altered_or_names_others_is_refused(tmp_path: Path) -> None:
    session = session_with(tmp_path / "bench", "a-1.csv")
    manifest = tmp_path / "bench" / "campaign.toml"
    for text, why in ((manifest.read_text(encoding="utf-8") + "\n", "altered"), ("", "")):
        archive.pack(tmp_path / "bench", tmp_path / "in.zip")
        if text:
            with zipfile.ZipFile(tmp_path / "in.zip") as old, zipfile.ZipFile(tmp_path / "bad.zip", "w") as new:
                for name in old.namelist():
                    new.writestr(name, text if name == "campaign.toml" else old.read(name))
            with pytest.raises(CampaignError, match=why):
                archive.unpack(tmp_path / "bad.zip", tmp_path / "new")
    secret = tmp_path / "secret.csv"
    secret.write_text("time_s,displacement_mm,force_kN\n0,0,0\n", encoding="utf-8")
    session.files["f1"] = secret
    session.write()
    archive.pack(tmp_path / "bench", tmp_path / "in.zip")
    with pytest.raises(CampaignError, match="not in the archive"):
        archive.unpack(tmp_path / "in.zip", tmp_path / "new")
    (tmp_path / "no.zip").write_bytes(b"PK nothing")
    with pytest.raises(CampaignError, match="no archive"):
        archive.unpack(tmp_path / "no.zip", tmp_path / "new")


def test_a_shortcut_opens_the_bench_on_its_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "Desktop").mkdir()
    monkeypatch.setattr(Path, "home", lambda: tmp_path)
    said = server.put_shortcut(tmp_path / "my lab")
    (entry,) = (tmp_path / "Desktop").iterdir()
    assert str(entry) in said
    content = entry.read_text(encoding="utf-8")
    assert f'-m shj_bayes bench "{tmp_path / "my lab"}"' in content
    with pytest.raises(CampaignError, match="cannot hold the path"):
        server.put_shortcut(tmp_path / 'a"; rm -rf x')


def test_a_set_that_is_brought_takes_a_name_that_none_has(tmp_path: Path) -> None:
    manifest, session = tmp_path / "there.toml", Session(tmp_path / "bench")
    for names in (("A",), ("A", "A (2)")):
        sets = "".join(f'[[set]]\nname = "{name}"\ndevice = []\n' for name in names)
        manifest.write_text(f'schema = "shj-bayes/campaign/1"\nname = "there"\n{sets}', encoding="utf-8")
        bring(session, manifest)
    assert [one.name for one in session.sets] == ["A", "A (2)", "A (2) (2)"]
