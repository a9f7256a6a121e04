"""Free travel near zero force after a reversal."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Free travel at zero force, then a contact that closes over a distance."""
    size = values["size"]
    return Contribution(slack_mm=size, take_up_mm=values["softness"] * size, open_at_start=values["start"])


EFFECT = Effect(
    id="slack",
    family="start_of_stroke",
    title="Free travel at reversals",
    statement="The connection moves {size:.1f} mm without load at every reversal before it picks up again.",
    equation="F = 0 over a distance g once the force has unloaded to zero; then 0.4 K over s g, then K",
    cause="Clearance of bolts, pins or the grips: backlash in series with the sliding surfaces.",
    shows="A flat step at zero force in every reversal, of one width in all amplitudes, speeds and clamping levels.",
    next_test="Two slow small cycles at low clamping, or a displacement gauge across the device itself.",
    parameters=(
        Prior("size", "mm", "uniform", 0.0, 10.0, "Standard holes give 2 mm a side; brfd-lehigh has 3 mm."),
        Prior(
            "softness", "1", "loguniform", 0.02, 5.0, "Bolts with unlike clearances meet one after another: s about 1."
        ),
        Prior("start", "1", "uniform", 0.0, 1.0, "Which side of its clearance the device rests against is chance."),
    ),
    act=act,
    acts=(("motion", "slack"),),
    source="The paper's brass shim ('slid rigidly back to zero').",
    start={"size": (0.5, 2.0, 6.0), "softness": (0.1, 1.0, 4.0), "start": (0.2, 0.8)},
    initial=("start",),
)
