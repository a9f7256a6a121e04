"""One line on a terminal while the compiler works, nothing otherwise."""

import sys
import time

import pytest

from shj_bayes.inference.fit import TEXT, told_when_slow


@pytest.mark.parametrize(
    ("terminal", "tell", "rest_s", "printed"),
    [(True, True, 0.2, TEXT), (True, True, 0.0, ""), (True, False, 0.2, ""), (False, True, 0.2, "")],
    ids=["slow", "quick", "not asked", "no terminal"],
)
def test_told_only_when_slow(
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    terminal: bool,
    tell: bool,
    rest_s: float,
    printed: str,
) -> None:
    monkeypatch.setattr(sys.stderr, "isatty", lambda: terminal, raising=False)
    with told_when_slow(tell, wait_s=0.05):
        time.sleep(rest_s)
    assert capsys.readouterr().err == printed
