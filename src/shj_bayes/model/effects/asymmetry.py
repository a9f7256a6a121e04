"""Push and pull capacities differ."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Clamping 1 + a q."""
    return Contribution(clamping=1.0 + values["size"] * history.direction)


def _shift(history: History, values: Values, base: Base) -> Contribution:
    """Add a share of Fy of the run: what every contact does by itself moves the loop as a whole."""
    return Contribution(added_kN=base.Fy * values["size"])


EFFECT = Effect(
    id="asymmetry",
    family="even_in_direction",
    title="Push and pull differ",
    statement="Sliding force is {size:+.0%} off the mean while displacement grows, and the opposite while it falls.",
    equation="Fy -> Fy (1 + a q), q = sign(v)",
    cause="Lever or band action, bolts that lean one way, or plates that pinch in one direction.",
    shows="One plateau level for each direction; the difference shrinks with Fy in the second run.",
    next_test="Read the load cell unloaded: a reading of zero leaves asymmetry, anything else is an offset.",
    parameters=(
        Prior("size", "1", "normal", 0.0, 0.15, "0-15 % in friction connections, more in band brakes; either sign."),
    ),
    act=act,
    acts=(("capacity", "direction"),),
    source="Assumed form: one factor for each direction, the least that makes push and pull differ.",
    start={"size": (0.05,)},
).with_form(
    "shift",
    statement="The whole loop is shifted by {size:+.0%} of Fy: each contact slides later in one direction.",
    equation="F -> F + a Fy, Fy that of the run",
    parameters=(Prior("size", "1", "normal", 0.0, 0.15, "As where capacity follows the direction at once."),),
    act=_shift,
    source="Masing's rule for contacts in parallel, each of which slides at 1 + a in push and at 1 - a in pull.",
    start={"size": (0.05,)},
)
