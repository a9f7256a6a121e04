"""Where the files that ship with the project are: priors/ and data/ at the top of the tree, or inside a wheel."""

from pathlib import Path


def shipped(*parts: str) -> Path:
    """Path of a shipped file or folder such as ``"priors", "afc.toml"``; `FileNotFoundError` where there is none."""
    package = Path(__file__).resolve().parents[1]
    for root in (package / "_shipped", package.parents[1]):
        candidate = root.joinpath(*parts)
        if candidate.exists():
            return candidate
    raise FileNotFoundError(f"{'/'.join(parts)} does not ship with this installation; reinstall shj-bayes")
