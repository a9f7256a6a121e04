"""Keys: same seed same keys, stated shares, sealed against change; recordings that give nothing away."""

import hashlib
import os
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from shj_bayes.errors import ModelError, ProofError
from shj_validation.proof import seal
from shj_validation.proof.cases import (
    CHALLENGE,
    DESIGNS,
    KINDS,
    MOST_READINGS,
    PROOF_1,
    PROOF_2,
    Key,
    canonical,
    development_keys,
    draw_keys,
)
from shj_validation.proof.make import make
from shj_validation.proof.noise import ALL_NOISES
from shj_validation.proof.protocols import PEAK_SPEED_MM_S, duration
from shj_validation.proof.run import write_recordings
from shj_validation.proof.simulators.simulator import simulators_by_id

SEED = 31  # of development


def test_same_seed_same_keys_and_another_seed_others():
    first, second, other = draw_keys(SEED, 12), draw_keys(SEED, 12), draw_keys(SEED + 1, 12)
    assert [canonical(a.to_dict()) for a in first] == [canonical(b.to_dict()) for b in second]
    assert [canonical(a.to_dict()) for a in first] != [canonical(b.to_dict()) for b in other]


@pytest.mark.parametrize("n", [20, 100, 201])
def test_shares_are_as_stated(n):
    kinds = Counter(key.kind for key in draw_keys(SEED, n))
    assert kinds["nothing"] >= n / 2
    assert kinds["outside"] == pytest.approx(0.15 * n, abs=1)
    assert kinds["two"] == pytest.approx(0.15 * n, abs=1)
    assert kinds["one"] > 0


def test_two_effects_are_never_the_same():
    for key in draw_keys(SEED, 200):
        assert len({one.id for one in key.effects}) == len(key.effects)
        assert len(key.effects) == {"nothing": 0, "one": 1, "outside": 1, "two": 2}[key.kind]


def test_two_effects_never_share_a_coordinate():
    known = simulators_by_id()
    for key in development_keys(SEED, 100, "two"):
        first, second = (set(known[one.id].coordinates) for one in key.effects)
        assert not first & second


def test_development_trials_are_the_same_however_many():
    for kind in KINDS:
        assert development_keys(SEED, 5, kind) == development_keys(SEED, 12, kind)[:5]
    assert development_keys(SEED, 3, "one", rate_Hz=5.0)[2].device == development_keys(SEED, 3, "one")[2].device


def test_development_takes_the_forms_of_an_effect_in_turn():
    assert {key.effects[0].id for key in development_keys(SEED, 3, "one", effect="wear")} == {
        "wear",
        "wear_saturating",
        "wear_power",
    }
    assert {key.effects[0].id for key in development_keys(SEED, 3, "one", effect="wear_power")} == {"wear_power"}
    with pytest.raises(ModelError, match="no simulator is 'were'"):
        development_keys(SEED, 3, "one", effect="were")


def test_development_and_proof_have_no_stream_in_common():
    proof, development = draw_keys(SEED, 30), [key for kind in KINDS for key in development_keys(SEED, 30, kind)]
    assert not {key.entropy for key in proof} & {key.entropy for key in development}


def test_every_protocol_noise_and_rate_is_drawn():
    keys = draw_keys(SEED, 400, PROOF_2)
    assert {key.protocol for key in keys} == set(PEAK_SPEED_MM_S)
    assert {key.nuisance.noise for key in keys} == set(ALL_NOISES)
    assert {key.rate_Hz for key in keys} == set(DESIGNS[PROOF_2].rates)
    assert min(key.rate_Hz for key in keys if key.nuisance.noise == "with hum") >= 20.0
    assert max(key.rate_Hz * duration(key.protocol) for key in keys) <= MOST_READINGS
    assert 0.3 < np.mean([key.machine_kN_mm > 0 for key in keys]) < 0.5
    assert all(key.reversal == "continuous" for key in keys if key.machine_kN_mm)
    assert 0.05 < np.mean([key.first_sd != 0 for key in keys]) < 0.15
    assert all(Key.from_dict(key.to_dict()) == key for key in keys)
    null = Counter(key.protocol for key in keys if key.kind == "nothing")
    assert max(null.values()) - min(null.values()) <= 1


def test_a_challenge_needs_no_reversal_rule():
    keys = draw_keys(SEED, 60, CHALLENGE)
    assert {key.reversal for key in keys} == {"continuous"}
    assert max(key.rate_Hz for key in keys) <= 20.0


def test_development_draws_from_the_same_design():
    how = {"design": DESIGNS[PROOF_2], "first": True}
    keys = development_keys(SEED, 12, "one", **how)
    assert keys[:5] == development_keys(SEED, 5, "one", **how)
    one = replace(keys[0], rate_Hz=5.0)
    off = make(one)[0].noise_kN[0] - make(replace(one, first_sd=0.0))[0].noise_kN[0]
    assert off == pytest.approx(one.first_sd * one.nuisance.noise_kN, abs=one.nuisance.force_step_kN)


@pytest.mark.parametrize(
    ("schema", "digest"),
    [
        (PROOF_1, "c9c80fd533f309ddfecea3224c733fbf0b162b40cd75f7fcd50b961207198817"),
        (PROOF_2, "59a2c13fae9b7102e1712156a888b5c08be2c3efffbf7ad315eb17087331d09f"),
        (CHALLENGE, "cf827738ddc609e60afb426fa15ebe3b5b5a0f1ee8fc5db09876b700018c463b"),
    ],
)
def test_what_is_sealed_does_not_change(schema, digest):
    """A proof of an old seed is made again to the byte."""
    own = hashlib.sha256()
    for key in draw_keys(SEED, 12, schema):
        own.update(canonical(key.to_dict()))
    assert own.hexdigest() == digest


def test_a_key_survives_its_text():
    for key in draw_keys(SEED, 10):
        assert Key.from_dict(key.to_dict()) == key


def test_no_trials_are_refused():
    with pytest.raises(ModelError, match="0 trials asked for; allowed is 1 or more"):
        draw_keys(SEED, 0)


def test_the_digest_notices_every_change():
    key = next(key for key in draw_keys(SEED, 20) if key.effects)
    sealed = seal.digest_of(key, "00")
    assert seal.digest_of(key, "00") == sealed
    assert seal.digest_of(key, "01") != sealed
    size = key.effects[0].size
    changed = replace(key, effects=(replace(key.effects[0], size=float(np.nextafter(size, 1e9))), *key.effects[1:]))
    assert seal.digest_of(changed, "00") != sealed


def test_the_secret_is_for_this_user_and_for_one_seed(tmp_path):
    first = seal.write_secret(tmp_path, SEED, 5)
    assert seal.write_secret(tmp_path, SEED, 5) == first
    assert len(set(first["nonces"])) == 5
    if os.name == "posix":
        assert (tmp_path / seal.SECRET).stat().st_mode & 0o077 == 0
    with pytest.raises(ProofError, match="unfinished proof of 5 trials, seed 31"):
        seal.write_secret(tmp_path, SEED, 6)


def test_a_proof_of_another_kind_is_refused_with_what_is_known(tmp_path):
    seal.write_secret(tmp_path, SEED, 2, PROOF_1)
    with pytest.raises(ProofError, match="unfinished proof of 2 trials, seed 31 --earlier; give"):
        seal.write_secret(tmp_path, SEED, 2)
    assert [key.protocol in ("paper", "improved") for key in seal.open_seal(tmp_path)] == [True, True]
    text = (tmp_path / seal.OPENED).read_text(encoding="utf-8")
    (tmp_path / seal.OPENED).write_text(text.replace("proof/1", "proof/9"), encoding="utf-8")
    with pytest.raises(ProofError, match=r"is of schema 'shj-bayes/proof/9'; known are shj-bayes/proof/1, "):
        seal.read_opened(tmp_path)


def test_opening_publishes_what_was_sealed(tmp_path):
    secret = seal.write_secret(tmp_path, SEED, 3)
    keys = seal.open_seal(tmp_path)
    opened = seal.read_opened(tmp_path)
    assert opened == seal.Opened(PROOF_2, SEED, keys, secret["nonces"])
    assert not (tmp_path / seal.SECRET).exists()


def test_recordings_hold_three_columns_and_nothing_else(tmp_path):
    null, full = draw_keys(SEED, 20)[0], next(key for key in draw_keys(SEED, 20) if key.effects)
    for key in (null, full):
        paths = write_recordings(key, tmp_path / str(key.number))
        assert [path.name for path in paths] == ["run1.csv", "run2.csv"]
        for path in paths:
            lines = path.read_text(encoding="utf-8").splitlines()
            assert lines[0] == "time_s,displacement_mm,force_kN"
            assert all(set(line) <= set("0123456789.,-+e") for line in lines[1:])


def test_recordings_are_made_again_to_the_byte(tmp_path):
    key = draw_keys(SEED, 20)[3]
    first = [path.read_bytes() for path in write_recordings(key, tmp_path / "a")]
    again = [path.read_bytes() for path in write_recordings(Key.from_dict(key.to_dict()), tmp_path / "b")]
    assert first == again


def test_the_held_out_earthquake_leaves_the_recordings_alone():
    key = draw_keys(SEED, 20)[2]
    short, long = make(key), make(key, heldout=True)
    assert len(long) == 3
    for a, b in zip(short, long, strict=False):
        assert np.array_equal(a.recording.force_kN, b.recording.force_kN)
