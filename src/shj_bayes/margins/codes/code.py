"""What a design code is: a name, how far its text was read, and a function from what is known of a set to margins."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field

from shj_bayes.margins.parts import Parts
from shj_bayes.margins.request import Request
from shj_bayes.margins.row import Margin
from shj_bayes.margins.sample import Sample
from shj_bayes.margins.spread import Spread


@dataclass(frozen=True)
class Given:
    """What a code is given of one set.

    Parameters
    ----------
    set_name : str
        The set, or "(any set)".
    samples : mapping of str to Sample
        Point values by quantity: of the devices, or of the sets for a set never tested.
    spreads : mapping of str to tuple of Spread
        Ways to come by the spread of each quantity.
    devices : mapping of str to int
        Tested devices behind each quantity.
    parts : Parts
        Nominal and delivered forces, ageing.
    request : Request
        Choices of the user.
    """

    set_name: str
    samples: Mapping[str, Sample] = field(repr=False)
    spreads: Mapping[str, tuple[Spread, ...]] = field(repr=False)
    devices: Mapping[str, int]
    parts: Parts
    request: Request


@dataclass(frozen=True)
class Code:
    """A design code.

    Parameters
    ----------
    id : str
        Name of its file.
    title : str
        As it is cited.
    text : str
        How far its text could be read, in words.
    rows : callable
        From what is given of a set to its margins.
    place : int
        Order on the sheet.
    """

    id: str
    title: str
    text: str
    rows: Callable[[Given], Iterator[Margin]]
    place: int
