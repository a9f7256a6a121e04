"""Devices whose force follows a further channel, such as the bolt tension, of which a virtual test knows nothing.

The channel is then taken at its median in the device's own test, and where its curve is lowest and highest in the range
that was recorded: the outermost of the three bounds the force.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from shj_bayes.margins.specimen import Specimen
from shj_bayes.model.coordinates import coordinate_named
from shj_bayes.model.curve import curve_named

PLACES = 41


@dataclass(frozen=True)
class Following:
    """A channel that the force of a device follows."""

    coordinate: str
    unit: str
    # low to high: least, median and largest value in the device's test
    low: float
    reference: float
    high: float
    # weakest, strongest: where the curve of the typical device is lowest and highest
    weakest: float
    strongest: float


def following_of(specimen: Specimen) -> tuple[Following, ...]:
    """Find the channels that the models of a device follow."""
    history, share = specimen.histories[0], np.linspace(0.0, 1.0, PLACES)
    out = {}
    for belief in specimen.beliefs:
        typical = belief.typical[0]
        for effect in belief.model.effects:
            curve = curve_named(effect.id)
            if curve is None or not curve.over.measured:
                continue
            own = [typical[belief.model.index(f"{effect.id}.{name}")] for name in effect.names]
            factor = curve.rows(share, np.ones(PLACES)) @ np.array(own)
            ends = curve.over.value_of(share[[np.argmin(factor), np.argmax(factor)]], history).tolist()
            one = history.measured[curve.coordinate]
            found = (curve.coordinate, one.unit, one.low, one.reference, one.high)
            out[curve.coordinate] = Following(*found, *ends)
    return tuple(out.values())


def values_to_try(specimen: Specimen) -> tuple[Mapping[str, float], ...]:
    """Values of the channels, by coordinate, at which a device is driven through a history that does not give them.

    Medians first; then, of a device that follows some, all where its force is lowest and all where it is highest: each
    multiplies the sliding force, so together they reach farthest.
    """
    found = following_of(specimen)
    if not found:
        return ({},)
    return (
        {one.coordinate: one.reference for one in found},
        {one.coordinate: one.weakest for one in found},
        {one.coordinate: one.strongest for one in found},
    )


def words_of(by_device: Sequence[tuple[Following, ...]], *, own_test: bool) -> tuple[str, ...]:
    """Say what forces follow, at which values they were taken, and what the designer has to see to.

    `own_test` is whether devices are taken through their own tests, of which the channels are known.
    """
    out = []
    for own, title, span in _by_channel(by_device):
        middle = float(np.median([one.reference for one in own]))
        how = (
            f"its values are those of the tests, {span}"
            if own_test
            else f"it is taken at the median of each test (typically {middle:.4g}), and limits are the outermost over "
            f"what was recorded, {span}"
        )
        out.append(
            f"The sliding force of {len(own)} of {len(by_device)} devices follows {title}: {how}. Outside that range "
            "nothing is known: keep the connection within it, or test where it will serve."
        )
    return tuple(out)


def left_out_words(by_device: Sequence[tuple[Following, ...]]) -> tuple[str, ...]:
    """Say what a material for structural analysis does not carry of that."""
    return tuple(
        f"Not carried, that the force follows {title}. The bounds are those of tests at {span}."
        for _, title, span in _by_channel(by_device)
    )


def _by_channel(by_device: Sequence[tuple[Following, ...]]) -> Iterator[tuple[list[Following], str, str]]:
    """Each channel: of the devices that follow it, its title, and the range that was recorded, in words."""
    for name in dict.fromkeys(one.coordinate for found in by_device for one in found):
        own = [one for found in by_device for one in found if one.coordinate == name]
        low, high = min(one.low for one in own), max(one.high for one in own)
        unit = f" {own[0].unit}" if own[0].unit else ""
        yield own, coordinate_named(name).title, f"{low:.4g} to {high:.4g}{unit}"
