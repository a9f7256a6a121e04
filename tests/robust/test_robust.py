"""Recordings cut, decimated, shifted, scaled, joined and repeated give numbers or a refusal in words."""

import sys
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from shj_bayes.errors import ShjError
from shj_bayes.inference.binning import runs_of
from shj_bayes.inference.likelihood import make_likelihood
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.priors import read_priors
from shj_bayes.recording.reader import read
from shj_bayes.recording.runs import check_recording, settle

HERE = Path(__file__).resolve().parent
sys.path.insert(0, str(HERE))

from changed_recordings import CHANGES, SIMULATED, Case, case, sources  # noqa: E402

from robust import BREACH, DONE, STEPS, outcomes, table  # noqa: E402

PUBLIC = HERE.parents[2] / "shared" / "recordings"
LONGEST = 300  # rows


def folder_of(kind: str) -> Path | None:
    """Folder of the public recordings, or None for simulated ones."""
    if kind == SIMULATED:
        return None
    if not PUBLIC.is_dir():
        pytest.skip("the public recordings (../shared/recordings) are not on this machine")
    return PUBLIC


@pytest.mark.parametrize("kind", [SIMULATED, "public"])
def test_changed_recordings_have_a_density_or_are_refused(kind, tmp_path):
    """The step that each of the four commands begins with, on a few of every kind of change."""
    folder, came = folder_of(kind), Counter()
    assert len(sources(folder)) >= 8
    for number in range(3 * len(CHANGES)):
        made = case(3, number, folder, longest=LONGEST)
        paths = made.write(tmp_path)
        density, words = density_of(made, paths)
        if density is None:
            assert words, made.words
            assert "\n" not in words, made.words
        else:
            assert not np.isnan(density).any(), made.words
        came["refused" if density is None else "read"] += 1
    assert set(came) == {"read", "refused"}  # the changes are neither harmless nor hopeless


def density_of(made: Case, paths: list[Path]) -> tuple[np.ndarray | None, str]:
    """Density in the middle of the prior, or None and why it is refused."""
    try:
        for path in paths:
            assert check_recording(path)
        runs = runs_of(settle([read(path) for path in paths], "one"))
        device = DeviceModel(len(runs), read_priors("general"), variant=made.options["model"])
        posterior = make_likelihood(runs, device)
        return posterior.log_posterior_free(np.zeros((1, len(posterior.model.names)))), ""
    except ShjError as error:
        return None, str(error)


def test_the_same_seed_makes_the_same_combination():
    first, again, other = (case(3, number, None, longest=LONGEST) for number in (4, 4, 5))
    assert (first.words, first.files[0].text()) == (again.words, again.files[0].text())
    assert first.words != other.words


def test_a_breach_is_counted_and_can_be_made_again():
    rows = [{"number": 3, "case": "", "fit": f"{BREACH} LinAlgError at data.py:9: x"}, {"number": 4, "fit": DONE}]
    words = table(rows)
    assert "2 cases, 1 breaches" in words
    assert "LinAlgError at data.py:9" in words
    assert "(case 3)" in words


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(CHANGES)))
@pytest.mark.parametrize("kind", [SIMULATED, "public"])
def test_all_commands_on_a_changed_recording(kind, number, tmp_path):
    said = dict(outcomes(3, number, folder_of(kind), tmp_path, longest=LONGEST))
    assert set(said) == set(STEPS)
    assert not [words for words in said.values() if words.startswith(BREACH)]
