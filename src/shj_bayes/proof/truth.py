"""What the key says that a diagnosis can be held against: what can be seen of it, and the true base parameters."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from shj_bayes.inference.run import runs_of
from shj_bayes.inference.squares import orthogonal_to
from shj_bayes.mismatch.evidence import Evidence, evidence_of
from shj_bayes.mismatch.refit import Refit, refit
from shj_bayes.model.device import DeviceModel
from shj_bayes.model.parameters import FloatArray
from shj_bayes.model.priors import Priors
from shj_bayes.proof.cases import Key
from shj_bayes.proof.make import Made, make
from shj_bayes.proof.simulators.simulator import simulators_by_id
from shj_bayes.recording.recording import Recording

PRACTICAL = 0.01  # of Fy: the size that the tool calls negligible for design (mismatch/thresholds.py), fixed here
EVIDENCE = 25.0  # log-likelihood that the visible part must be worth under the trial's own noise


@dataclass(frozen=True, eq=False)
class Truth:
    """What is known about a trial once its key is open.

    Parameters
    ----------
    base : dict of str to float
        Base parameters of the same rig without noise and without what is concealed: Eq. (1) fitted to it.
    visible_share : float
        Part of what is concealed that no base parameters can take up, 99th percentile, as a share of Fy.
    evidence : float
        Log-likelihood that this part is worth under the trial's noise.
    bare_share : float
        The same percentile for the rig without anything concealed: what the nuisances and the Iwan element leave.
    residual_kN : array, shape (n,)
        The visible part, kN, at the samples of `evidence_of`.
    scene : Evidence
        Those samples.
    each : dict of str to (float, float)
        By effect, ``visible_share`` and ``evidence`` of the force that it adds to that of the others.
    """

    base: dict[str, float]
    visible_share: float
    evidence: float
    bare_share: float
    residual_kN: FloatArray
    scene: Evidence
    each: dict[str, tuple[float, float]]

    @property
    def detectable(self) -> bool:
        """Whether any of what is concealed must be named."""
        return bool(self.required)

    @property
    def required(self) -> set[str]:
        """Effects that must be named: beside the other one, each matters and can be told from the noise by itself."""
        return {name for name, (share, worth) in self.each.items() if share >= PRACTICAL and worth >= EVIDENCE}


def truth_of(key: Key, priors: Priors, made: list[Made] | None = None) -> Truth:
    """Work out the truth of a trial from its key.

    Parameters
    ----------
    key : Key
        The opened key.
    priors : Priors
        Of the base parameters; they hold the fit where the recording says nothing.
    made : list of Made, optional
        The trial's recordings, where they have been made already.

    Returns
    -------
    Truth
    """
    made = made or make(key)
    bare_scene, bare = _fit_perfect(make(key, effects=()) if key.effects else made, key, priors)
    scene, fit = _fit_perfect(made, key, priors)
    residual = fit.residual_kN
    own = scene.weight > 0
    share = float(np.percentile(np.abs(residual[own]), 99)) / key.device.Fy
    each = {key.effects[0].id: (share, _worth(residual[own], made))} if len(key.effects) == 1 else {}
    if len(key.effects) > 1:
        for one in key.effects:
            others = [other for other in key.effects if other.id != one.id]
            lesser, _ = _fit_perfect(make(key, effects=others), key, priors)
            alone = orthogonal_to(fit.jacobian, ((scene.force_kN - lesser.force_kN) * scene.weight)[:, None])[own, 0]
            each[one.id] = (float(np.percentile(np.abs(alone), 99)) / key.device.Fy, _worth(alone, made))
    return Truth(
        base=bare.model.law_values(bare.z),
        visible_share=share,
        evidence=_worth(residual[own], made),
        bare_share=float(np.percentile(np.abs(bare.residual_kN[bare_scene.weight > 0]), 99)) / key.device.Fy,
        residual_kN=residual,
        scene=scene,
        each=each,
    )


def _worth(visible_kN: FloatArray, made: list[Made]) -> float:
    """Log-likelihood that a part of the force is worth under the trial's own noise."""
    noise = np.concatenate([one.noise_kN for one in made[:2]])
    phi = float(np.clip(np.corrcoef(noise[:-1], noise[1:])[0, 1], 0.0, 0.99))
    # Thinned samples of slow residuals: each stands for several samples of the recording, all of which add.
    innovation = float(np.mean((1 - phi) ** 2 * visible_kN**2))
    return 0.5 * innovation / float(noise.var() * (1 - phi**2)) * sum(one.clean_kN.size for one in made[:2])


def effect_truths(key: Key) -> dict[str, dict[str, float]]:
    """List true values of the catalogue's parameters by effect, where the physics has an exact counterpart."""
    known = simulators_by_id()
    out = {}
    for one in key.effects:
        values = dict(known[one.id].truth(one.size, one.shape, key.device))
        if one.id == "sensor_lag" and "size" in values:  # the nuisances add to it
            values["size"] += key.nuisance.lag_s
        # An offset too small to be named shows as a difference between push and pull.
        if one.id in ("load_offset", "asymmetry") and "size" in values:
            values["size"] += key.nuisance.offset_kN / key.device.Fy
        out[one.id] = values
    return out


def kept_base(key: Key) -> set[str]:
    """Name the base parameters that keep their meaning beside everything that is concealed."""
    names = {"K", "Fy", "beta", "gamma", "ratio"}
    for one in key.effects:
        names &= set(simulators_by_id()[one.id].base)
    return names


def _fit_perfect(made: list[Made], key: Key, priors: Priors) -> tuple[Evidence, Refit]:
    """Fit the base law to what a recorder without noise would show."""
    perfect = [Recording(one.recording.time_s, one.x_mm, one.clean_kN) for one in made[:2]]
    scene = evidence_of(runs_of(perfect), 4000)
    model = DeviceModel(len(perfect), priors, variant="continuous")
    device = {"K": key.device.K, "Fy": key.device.Fy, "beta": key.device.beta, "gamma": key.device.gamma}
    device["ratio"] = key.device.ratio
    z = model.unbounded(np.array([[device.get(name, 1.0) for name in model.names]]))[0, : model.n_law]
    return scene, refit(scene, model, [z], sigma_kN=key.nuisance.noise_kN)
