"""Elastic loading frame or grip in series."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Series compliance 1/K_f."""
    return Contribution(compliance_mm_per_kN=values["size"])


EFFECT = Effect(
    id="frame_compliance",
    family="start_of_stroke",
    title="Elastic frame or grip in series",
    statement="The frame or grip gives {size:.4f} mm per kN: the stiffness seen is not that of the connection alone.",
    equation="x_device = x - F/K_f",
    cause="The displacement was measured at the actuator: frame, grips and pins stretch along with the device.",
    shows="Slopes at every reversal softer than the device, bends at the knee sharper; almost wholly taken up by K.",
    next_test="Record displacement across the device and at the actuator: the difference against force gives K_f.",
    parameters=(
        Prior("size", "mm/kN", "lognormal", 0.01, 1.5, "K_f 100 kN/mm in the middle, 5 to 2000 kN/mm at two sd."),
    ),
    act=act,
    acts=(("motion", "compliance"),),
    source="Springs in series.",
    start={"size": (0.003, 0.03)},
)
