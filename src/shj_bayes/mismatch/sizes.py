"""How large the classes of a hypothesis are: the force that each makes and that the base law could not."""

import numpy as np

from shj_bayes.mismatch.classes import DOUBT, EXPLAINED, MATTERS
from shj_bayes.mismatch.hypothesis import CONSTANT, Hypothesis, columns_of
from shj_bayes.mismatch.scene import Scene
from shj_bayes.mismatch.state import drawn_from, largest, visible
from shj_bayes.model.parameters import FloatArray

MOTION = "motion"
N_SIZES = 60  # draws from which the upper limit of a size is taken
NO_FORCE = 1e6  # size of a draw whose force is not finite


def size_of(scene: Scene, h: Hypothesis, place: int) -> float:
    """Size of a member at the most probable parameters, as a share of Fy.

    The 99th percentile of its force that the base law could not make, by `visible`; of a constant, all of it.
    """
    return float(_sizes_at(scene, h, place, h.state.z[None])[0])


def largest_size_of(scene: Scene, h: Hypothesis, place: int) -> float:
    """Upper limit of the size of a member, exceeded with a probability of `DOUBT`, a share of Fy."""
    return float(np.quantile(sizes_of(scene, h, place), 1.0 - DOUBT))


def sizes_of(scene: Scene, h: Hypothesis, place: int) -> FloatArray:
    """Sizes of a member for draws of the parameters of its model, shape (N_SIZES,), as shares of Fy.

    Far from what fits a model may have no force at all; nothing says that the member is small there.
    """
    return np.nan_to_num(_sizes_at(scene, h, place, drawn_from(h.state, N_SIZES)), nan=NO_FORCE, posinf=NO_FORCE)


def _sizes_at(scene: Scene, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Size of a member for each of some parameter sets of its model, shape (m, n_law) to (m,).

    What acts on the motion makes its force between the bends of the base law, where the blocks of a search are long. A
    constant is as large as it is: the law makes none, also where it begins loaded by it.
    """
    if h.members[place].of.id == CONSTANT:
        return np.asarray(np.abs(_change(scene, h, place, z)[:, scene.used > 0]).max(axis=1) / scene.scale_kN)
    if h.members[place].of.action == MOTION:
        scene = scene.finer_at(h.state.model, h.state.z)
    return visible(scene, _law_slopes(h, scene), _change(scene, h, place, z).T)


def _change(scene: Scene, h: Hypothesis, place: int, z: FloatArray) -> FloatArray:
    """Force of a member for each of some parameter sets of its model, shape (m, n_law) to (m, n), kN."""
    model, effect = h.state.model, h.members[place].variant.effect
    rest = tuple(e for e in model.effects if e.id != effect.id)
    others = np.delete(z, columns_of(scene, h.state, place), axis=1)
    return scene.residual(model.with_effects(rest), others) - scene.residual(model, z)


def _law_slopes(h: Hypothesis, scene: Scene) -> FloatArray:
    """Give the derivatives of the law by itself, shape (n, n_law), kN.

    Beside a constant of many times Fy, a change of Fy is a change of the constant.
    """
    device, law = scene.device, h.state.of_law(scene.device)
    return scene.jacobian(device, law, scene.residual(device, law[None])[0])


def may_miss(scene: Scene, h: Hypothesis, place: int) -> float:
    """How far a formula may be from a curve that it is the name of, a share of Fy.

    At most half of the curve: a formula that leaves more than it explains says nothing.
    """
    size = size_of(scene, h, place)
    return min(max(MATTERS, (1.0 - EXPLAINED) * size), 0.5 * size)


def away(scene: Scene, a: Hypothesis, b: Hypothesis) -> float:
    """How far the forces of two hypotheses are apart (99th percentile over the samples), as a share of Fy."""
    used = scene.used > 0
    apart = (b.state.residual - a.state.residual)[used, None]
    return float(largest(apart, scene.count[used])[0]) / scene.scale_kN
