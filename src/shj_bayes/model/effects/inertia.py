"""Mass moving with the device."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior

KN_PER_KG_MM_S2 = 1e-6


def act(history: History, values: Values, base: Base) -> Contribution:
    """Add m a."""
    return Contribution(added_kN=values["size"] * KN_PER_KG_MM_S2 * history.acceleration_mm_s2)


EFFECT = Effect(
    id="inertia",
    family="odd_in_position",
    title="Mass moving with the device",
    statement="A mass of {size:.0f} kg moves between device and load cell; subtract m a if it is known.",
    equation="F -> F + m a",
    cause="Fixtures or part of the actuator between the load cell and the sliding surface.",
    shows="Force against the displacement, most at reversals, growing with the square of the frequency.",
    next_test="Repeat one amplitude at half the frequency: the part due to mass falls to a quarter.",
    parameters=(Prior("size", "kg", "loguniform", 0.1, 2e4, "From a clamp to a heavy actuator with its beam."),),
    act=act,
    acts=(("added", "acceleration"),),
    source="Newton's second law.",
    start={"size": (100.0,)},
)
