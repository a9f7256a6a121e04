"""A challenge from kit to score: nothing in the kit tells, sheets are read as people leave them, the seal holds."""

import gzip
import json
import shutil
from pathlib import Path

import pytest
from click.testing import CliRunner

from shj_bayes.cli import main
from shj_bayes.errors import ProofError
from shj_bayes.model.effects.effect import catalogue
from shj_validation.proof import challenge
from shj_validation.proof.cases import CHALLENGE, draw_keys, stated_key
from shj_validation.proof.challenge import Answer, answer_of, judge, make_challenge, read_sheet, score_challenge
from shj_validation.proof.simulators.simulator import ACTIONS, COORDINATES, simulators_by_id

SEED, N = 5, 4  # of development
DEVICES = ("D01", "D02", "D03", "D04")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    folder = tmp_path_factory.mktemp("made") / "kit"
    make_challenge(folder, N, SEED)
    return folder


@pytest.fixture
def kit(whole, tmp_path):
    """A kit of its own for each test, with the file that opens it."""
    shutil.copy(challenge.opening_of(whole), tmp_path)
    return Path(shutil.copytree(whole, tmp_path / "kit"))


def filled(kit, *rows, name="answers.csv", head="device,missing,coordinate,effect,confidence"):
    """Write a sheet."""
    (kit / name).write_text("\n".join([head, *rows]) + "\n", encoding="utf-8")
    return kit / name


def test_a_kit_end_to_end_by_the_command_line(kit):
    keys = draw_keys(SEED, N, CHALLENGE)
    held = {key.number: key for key in keys if key.effects}
    rows = []
    for key in keys:
        if key.number in held:
            pairs = (simulators_by_id()[one.id].coordinates[0] for one in key.effects)
            rows.append(f"D{key.number:02d},yes,{' + '.join(' over '.join(pair) for pair in pairs)},,90 %")
        else:
            rows.append(f"D{key.number:02d},no,,,")
    sheet = filled(kit, *rows)
    filled(kit, *(f"{name},cannot tell,,," for name in DEVICES), name="ours.csv")
    packed = kit / "recordings" / "D01_run1.csv"  # as the kit that ships
    Path(f"{packed}.gz").write_bytes(gzip.compress(packed.read_bytes()))
    packed.unlink()
    done = CliRunner().invoke(main, ["prove", "--score", str(sheet), "-o", str(kit / "score")])
    assert done.exit_code == 0, done.output
    assert "made again from the truth: the same to the byte" in done.output
    record = json.loads((kit / "score" / "challenge.json").read_text(encoding="utf-8"))
    own, ours = record["totals"].values()
    assert own["coordinate right, where one was named"]["share"] == 1.0
    assert own["something claimed where nothing is concealed"]["hits"] == 0
    assert own["rows with a confidence: right"]["stated"] == pytest.approx(0.9)
    assert ours["cannot tell, of all that count"]["share"] == 1.0
    assert len((kit / "score" / "challenge.csv").read_text(encoding="utf-8").splitlines()) == N + 1


def test_the_kit_tells_nothing_and_the_file_beside_it_opens_it(kit):
    opening = challenge.opening_of(kit)
    assert opening.parent == kit.parent
    texts = [path.read_text(encoding="utf-8") for path in kit.rglob("*") if path.is_file()]
    sizes = [repr(one.size) for key in draw_keys(SEED, N, CHALLENGE) for one in key.effects]
    assert sizes
    assert not [size for size in sizes for text in texts if size in text]
    sheet = filled(kit, *(f"{name},cannot tell,,," for name in DEVICES))
    opening.unlink()
    with pytest.raises(ProofError, match="ask whoever made the kit for its seed, and give it with --seed"):
        score_challenge(sheet)
    assert score_challenge(sheet, SEED).record["seed"] == "5"


def test_a_seed_is_drawn_from_many_and_a_kit_is_not_overwritten(tmp_path):
    opening = make_challenge(tmp_path / "kit", 1)
    assert int(json.loads(opening.read_text(encoding="utf-8"))["seed"]) > 2**64
    with pytest.raises(ProofError, match="would make its answers worthless"):
        make_challenge(tmp_path / "kit", 1)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda s: s.update(schema="other"), r"seal.json in kit is no seal of a challenge"),
        (lambda s: s["devices"][1].pop("files"), r"seal.json in kit lacks something"),
        (lambda s: s["devices"].pop(0), "must list D01, D02 ... in order, 999 devices at most"),
        (lambda s: s["devices"][0]["files"][0].update(name="../../answers.csv"), r"answers.csv is not in the kit"),
    ],
)
def test_a_damaged_seal_is_refused_in_words(kit, change, words):
    sheet = filled(kit, *(f"{name},cannot tell,,," for name in DEVICES))
    sealed = json.loads((kit / "seal.json").read_text(encoding="utf-8"))
    change(sealed)
    (kit / "seal.json").write_text(json.dumps(sealed), encoding="utf-8")
    with pytest.raises(ProofError, match=words):
        score_challenge(sheet)


def test_another_seed_and_a_changed_recording_are_noticed(kit):
    sheet = filled(kit, *(f"{name},cannot tell,,," for name in DEVICES))
    with pytest.raises(ProofError, match="from seed 6 is not what was sealed"):
        score_challenge(sheet, 6)
    path = kit / "recordings" / "D03_run2.csv"
    path.write_text(path.read_text(encoding="utf-8") + "9,9,9\n", encoding="utf-8")
    with pytest.raises(ProofError, match=r"D03_run2.csv is not the recording that was sealed"):
        score_challenge(sheet)
    path.unlink()
    with pytest.raises(ProofError, match=r"D03_run2.csv is not in the kit, nor D03_run2.csv.gz"):
        score_challenge(sheet)


EXCEL = "Device;MISSING;Coordinate;Effect;Confidence;remarks\r\n{}"
ROWS = (
    "D01;Yes;Capacity / Travel ; Wear ;0,8;;",
    "2;NO;;;;",
    ";;;;;",
    "d03;Can\u2019t tell;;;",
    "D04;yes;;unknown;90 %;odd",
)


@pytest.mark.parametrize(
    "raw",
    [
        EXCEL.format("\r\n".join(ROWS)).encode("utf-8-sig"),
        EXCEL.format("\r\n".join(ROWS)).encode("cp1252"),
        EXCEL.format("\r\n".join(ROWS)).encode("utf-16"),
        ("sep=;\r\n" + EXCEL.format("\r\n".join(ROWS))).encode("utf-8"),
        EXCEL.format("\r\n".join(ROWS)).replace(";", "\t").encode("utf-8"),
    ],
)
def test_a_sheet_from_a_spreadsheet_is_read(tmp_path, raw):
    (tmp_path / "a.csv").write_bytes(raw)
    read = read_sheet(tmp_path / "a.csv", DEVICES)
    assert read["D01"] == Answer("D01", "yes", (("capacity over travel",),), (("wear",),), 0.8)
    assert (read["D02"].missing, read["D03"].missing) == ("no", "cannot tell")
    assert read["D04"] == Answer("D04", "yes", (), (("unknown",),), 0.9)


@pytest.mark.parametrize(
    ("row", "words"),
    [
        ("D02,maybe,,,", r"row 3 \(D02\), column missing: 'maybe'; allowed is yes, no or cannot tell"),
        ("D02,,,,", r"row 3 \(D02\), column missing: empty; allowed is yes, no or cannot tell"),
        ("D02,no,capacity over travel,,", r"column coordinate: 'capacity over travel' beside missing = no; leave it"),
        ("D02,yes,travel,,", r"column coordinate: 'travel' is none; write ACTION over COORDINATE, actions capacity"),
        ("D02,yes,,rust,", r"column effect: 'rust' is no effect; allowed is centre_wear, .*unknown, or empty"),
        ("D02,yes,,,7", r"column confidence: '7'; allowed is 0 to 1, 0 % to 100 %, or empty"),
        ("D02,yes,,,nan", r"column confidence: 'nan'; allowed is"),
        ("D07,no,,,", r"row 3, column device: 'D07' is no device of this kit; allowed is D01 to D04, each once"),
        ("D01,no,,,", r"row 3 \(D01\), column device: stands there twice"),
        ("", "no row for D02; write 'cannot tell' where you have no answer"),
        (f"D02,yes,{' or '.join(['capacity over time'] * 3)},,", "3 alternatives; at most 2 may be joined with 'or'"),
    ],
)
def test_a_sheet_filled_in_wrongly_is_refused_with_its_place(kit, row, words):
    rest = [f"{name},no,,," for name in ("D03", "D04")]
    with pytest.raises(ProofError, match=words):
        score_challenge(filled(kit, "D01,no,,,", row, *rest))


def test_a_sheet_without_its_kit_or_its_columns_is_refused(kit, tmp_path):
    with pytest.raises(ProofError, match=r"seal.json is not beside answers.csv"):
        score_challenge(filled(tmp_path, "D01,no"))
    with pytest.raises(ProofError, match="row 1: column 'missing' must stand there once; found device, fehlt"):
        read_sheet(filled(kit, "D01,no", head="device,fehlt"), DEVICES)
    (kit / "empty.csv").write_text("\n\n", encoding="utf-8")
    with pytest.raises(ProofError, match=r"empty.csv is empty; its first row names the columns device, missing"):
        read_sheet(kit / "empty.csv", DEVICES)


WEAR, SEAM = stated_key("wear", 0.05, seed=3), stated_key("seam", 0.1, seed=3)
TRAVEL, TIME = "capacity over travel", "capacity over time"
SWING = stated_key("clamping_swing", 0.06, seed=3)


@pytest.mark.parametrize(
    ("key", "required", "answer", "judged"),
    [
        (WEAR, {"wear"}, Answer("D01", "yes", ((TRAVEL,),), (("wear",),)), (True, True, True)),
        (WEAR, {"wear"}, Answer("D01", "yes", ((TIME,), (TRAVEL,))), (True, True, "not said")),
        (WEAR, {"wear"}, Answer("D01", "yes", ((TRAVEL, "added over time"),)), (True, False, "not said")),
        (WEAR, {"wear"}, Answer("D01", "no"), (False, "not said", "not said")),
        (WEAR, {"wear"}, Answer("D01", "cannot tell"), ("not said", "not said", "not said")),
        (WEAR, set(), Answer("D01", "no"), (None, None, None)),
        (SEAM, {"seam"}, Answer("D01", "yes", (("capacity over position",),)), (True, True, True)),
        (SEAM, {"seam"}, Answer("D01", "yes", (("capacity over position",),), (("taper",),)), (True, True, False)),
        (SWING, {"clamping_swing"}, Answer("D01", "yes", (), (("unknown",),)), (True, "not said", True)),
    ],
)  # fmt: skip
def test_a_row_is_held_against_its_key(key, required, answer, judged):
    row = judge(key, required, answer)
    assert (row["missing"], row["coordinate"], row["effect"]) == judged


def test_the_instructions_have_every_word_that_is_allowed(kit):
    text = (kit / "README.txt").read_text(encoding="utf-8")
    words = {*ACTIONS, *COORDINATES, *(effect.mechanism for effect in catalogue().values())}
    listed = {line[:17].strip() for line in text.splitlines()}
    assert words <= listed
    assert max(map(len, text.splitlines())) <= 120


def test_our_own_rows_have_the_form_that_everyone_fills_in(kit):
    def entry(action, coordinate, probability):
        return {"action": action, "coordinate": coordinate, "probability": probability}

    found = {
        "verdict": "family",
        "effects": [{"id": "wear_power", "rivals": []}],
        "family": [{"id": "wear_power"}, {"id": "thermal"}],
        "coordinates": [entry("capacity", "heat", 0.4), entry("capacity", "travel", 0.6)],
        "sets": [{"classes": ["capacity over travel"]}, {"classes": ["capacity over heat"]}],
    }
    rows = [
        answer_of("D01", found),
        answer_of("D02", found | {"verdict": "adequate"}),
        answer_of("D03", found | {"verdict": "unknown", "sets": []}),
        answer_of("D04", {"error": "no"}),
    ]
    challenge.write_sheet(kit / "ours.csv", [row.cells for row in rows])
    assert list(read_sheet(kit / "ours.csv", DEVICES).values()) == rows
    assert rows[0] == Answer(
        "D01", "yes", (("capacity over travel",), ("capacity over heat",)), (("wear",), ("thermal",)), 0.6
    )
    assert rows[2].cells == ("D03", "yes", "capacity over travel", "unknown", "0.60")
