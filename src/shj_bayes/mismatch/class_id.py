"""The word of a class of coordinates in files: how it acts on the force, and on what it depends."""

from __future__ import annotations

from typing import NamedTuple


class ClassId(NamedTuple):
    """A class by its action and its coordinate; its word is ``capacity over travel`` and the like."""

    action: str
    coordinate: str

    def __str__(self) -> str:
        """Word of the class."""
        return f"{self.action} over {self.coordinate}"

    @classmethod
    def read(cls, word: str) -> ClassId:
        """Read the word of a class.

        Raises
        ------
        ValueError
            If it is none.
        """
        action, coordinate = word.split(" over ")
        return cls(action, coordinate)
