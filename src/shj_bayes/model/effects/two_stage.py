"""Second sliding surface that engages later."""

from shj_bayes.model.effects.effect import Base, Contribution, Effect, Values
from shj_bayes.model.history import History
from shj_bayes.model.priors import Prior


def act(history: History, values: Values, base: Base) -> Contribution:
    """Put a share of stiffness and capacity behind a clearance (mm) that is crossed at zero force."""
    return Contribution(second_surface=(values["size"], values["delay"], values["bolts"]))


EFFECT = Effect(
    id="two_stage",
    family="start_of_stroke",
    title="Second sliding surface",
    statement="{size:.0%} of the sliding force comes from a second surface that follows {delay:.1f} mm later.",
    equation="F = (1 - s) F_MP + s F_MP with a gap of d0 at zero force",
    cause="Asymmetric connection: the cap-plate side slides only once the bolts have leaned over.",
    shows="A knee part-way up every reversal at a fixed distance, the same in all amplitudes and speeds.",
    next_test="A displacement gauge on the cap plate: it stands still for the first few millimetres.",
    parameters=(
        Prior(
            "size", "1", "uniform", 0.0, 0.6, "Half for two equal surfaces, the cap-plate side being the weaker one."
        ),
        Prior("delay", "mm", "loguniform", 0.3, 15.0, "1 to 5 mm for M16 bolts with 2 mm hole clearance."),
        Prior("bolts", "1", "uniform", 0.1, 1.0, "Stiffness over its share of K: bolts that bend make it softer."),
    ),
    act=act,
    acts=(("motion", "second surface"),),
    source="MacRae et al. 2010, Bulletin NZSEE 43(3), 202: the bolts of asymmetric friction connections.",
    start={"size": (0.3,), "delay": (1.0, 3.0, 8.0), "bolts": (0.8,)},
)
