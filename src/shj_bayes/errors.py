"""What can go wrong, as a tree; every message says what came, what is allowed and what to do."""

import difflib
import unicodedata
from collections.abc import Iterable
from contextlib import suppress
from pathlib import PurePath

MAX_MESSAGE = 1000  # characters; a file that is quoted at length says less than its beginning
_STEERING = {"Cc", "Cf", "Cs", "Co", "Zl", "Zp"}  # control, direction marks, halves of characters, line separators


def plain_text(text: str) -> str:
    """Text without characters that steer a terminal, turn the direction of writing, or cannot be written at all."""
    if text.isascii() and text.isprintable():
        return text
    with suppress(UnicodeError):  # letters that a locale without them left as the halves of characters
        text = text.encode("utf-8", "surrogateescape").decode("utf-8", "surrogateescape")
    return "".join(" " if unicodedata.category(c) in _STEERING else c for c in text)


def plain_lines(text: str) -> str:
    """Text of several lines, each as `plain_text`."""
    return "\n".join(map(plain_text, text.split("\n")))


def shown(value: object, length: int = 80) -> str:
    """Give a value from a file as short text, also a whole number of more digits than Python writes out."""
    try:
        text = repr(value)
    except ValueError:
        return "a number of thousands of digits"
    return text if len(text) <= length else f"{text[:length]}..."


def did_you_mean(word: str, known: Iterable[str]) -> str:
    """End of a sentence that names the nearest known word, ``"; did you mean 'prying'?"``; empty when none is near."""
    folded = {name.casefold(): name for name in known}
    near = difflib.get_close_matches(word.casefold(), folded, n=1, cutoff=0.6)
    return f"; did you mean '{folded[near[0]]}'?" if near else ""


class StrangeFileError(OSError):
    """A device or a pipe where a file is needed, of which the words say what to do."""


def system_words(error: OSError) -> str:
    """Say what the system refuses, of which file, and what to look at."""
    if isinstance(error, StrangeFileError):
        return f"{plain_text(PurePath(str(error.filename)).name)}: {error.strerror}"
    where = f" ({PurePath(str(error.filename)).name})" if error.filename else ""
    return f"{plain_text(error.strerror or str(error))}{where}; check the path, the rights and the free space"


def words_of(error: Exception) -> str:
    """Say why a piece of work failed, whatever it raised; the type of an unexpected error says that it is a bug."""
    if isinstance(error, ShjError):
        return str(error)
    if isinstance(error, OSError):
        return system_words(error)
    if isinstance(error, MemoryError):
        return "not enough memory; use fewer --workers, or export fewer samples"
    return plain_text(f"unexpected {type(error).__name__}: {error}")


class ShjError(Exception):
    """Base of every error that a user can mend; the command line prints it as one line and exits 1.

    It may quote a file, so what could steer a terminal is taken out.
    """

    def __init__(self, message: str) -> None:
        text = plain_text(message)
        super().__init__(text if len(text) <= MAX_MESSAGE else f"{text[:MAX_MESSAGE]} ...")


class RecordingError(ShjError):
    """A recording cannot be read or cannot be used."""


class ModelError(ShjError):
    """A parameter or a model choice outside what the law allows."""


class OptionError(ModelError, TypeError):
    """An option of a function that there is not."""


class PriorError(ShjError):
    """A prior file that is malformed or cannot hold the data."""


class InferenceError(ShjError):
    """The sampler could not start or gave nothing usable."""


class CheckpointError(InferenceError):
    """A checkpoint of another problem, or an altered one."""


class StrangeCheckpointError(CheckpointError):
    """A checkpoint that is in order and of another problem."""


class CampaignError(ShjError):
    """A manifest or a campaign folder that cannot be used."""


class PopulationError(ShjError):
    """Too little, or contradictory, input for a population statement."""


class PlanError(ShjError):
    """A plan that a rig, a folder or a question does not allow."""


class ReportError(ShjError):
    """A results folder that cannot be shown."""


class ProofError(ShjError):
    """A proof folder that cannot be gone on with, or does not check."""
