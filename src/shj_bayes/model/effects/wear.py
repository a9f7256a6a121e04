"""Force falls with travel."""

from __future__ import annotations

import numpy as np

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping exp(-w s); travel s goes on from run to run."""
    return Contribution(clamping=np.exp(-values["size"] * history.travel_m))


EFFECT = Effect(
    id="wear",
    family="slow_change",
    title="Force falls with travel",
    statement="Sliding force falls by {size:.1%} per metre slid: part of the degradation happens within the run.",
    equation="Fy -> Fy exp(-w s)",
    cause="Wear of shim or coating relaxes the bolts: 0.03 mm of thickness is a tenth of an M16 bolt's tension.",
    shows="Every plateau a little lower than the one before, alike in position and speed; the second run carries on.",
    next_test="Repeat the first blocks at the end (against amplitude); two pauses of 15 min (against heating).",
    parameters=(
        Prior("size", "1/m", "lognormal", 0.05, 1.5, "Losses of 8-80 % over 3.84 m (Tables 3-7) are 0.02-0.4 per m."),
    ),
    neutral={"size": 0.0},
    act=act,
    source="DOMAIN E06: Archard wear with the bolt as a spring.",
    start={"size": (0.02,)},
)
