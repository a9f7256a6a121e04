"""What the data do not say of a parameter, as values: their sentences stand in ``report/words.py``."""

import numpy as np

from shj_bayes.model.device import DeviceModel
from shj_bayes.model.parameters import FloatArray
from shj_bayes.results.fit import Remark, RemarkRecord

UNDETERMINED = 0.6  # of the prior's width: the data took less than half of the uncertainty away
AGAINST = 2.6  # standard deviations of the prior: 1 in 100 beyond it


def remarks_of(model: DeviceModel, chains: FloatArray) -> tuple[RemarkRecord, ...]:
    """Parameters that the recordings do not determine, and those whose value the prior holds nearly impossible.

    From draws of shape (..., d) in natural units; of the law alone, since nobody designs with the noise.
    """
    flat = chains.reshape(-1, chains.shape[-1])
    out = []
    for i, (name, law) in enumerate(zip(model.law_names, model.laws_of_parameters, strict=False)):
        if not model.predicted[i]:
            continue
        place = law.to_free(flat[:, i])  # standard normal, were there no data
        place = place[np.isfinite(place)]
        kind = None
        # A recording that adds nothing to what an earlier one said leaves the parameter as well known.
        if place.size and np.std(place) > UNDETERMINED and not law.earlier:
            kind = Remark.UNDETERMINED
        elif place.size and abs(np.median(place)) > AGAINST:
            kind = Remark.AGAINST_EARLIER if law.earlier else Remark.AGAINST_PRIOR
        if kind:
            low, high = law.quantile(np.array([0.05, 0.95])).tolist()
            middle = float(np.median(flat[:, i]))
            out.append(RemarkRecord(parameter=name, kind=kind, q50=middle, prior_q05=low, prior_q95=high))
    return tuple(out)
