"""White noise and a slow part (Ornstein-Uhlenbeck) with a memory of seconds: means the same at any sampling rate.

r(t) = w(t) + s(t), sd(w) = sigma_white, cov(s(t), s(t')) = sigma_slow^2 exp(-|t - t'| / tau_slow).
"""

from shj_bayes.model.noise.noise import SLOW, TAU, WHITE, Noise, NoiseComponents, Values, exponential, gaussian


def parts(values: Values) -> NoiseComponents:
    """White from sample to sample, slow as it is."""
    return gaussian(values["sigma_white"], values["sigma_slow"])


NOISE = Noise(id="slow", own=(WHITE, SLOW, TAU), parts=parts, decay=exponential)
