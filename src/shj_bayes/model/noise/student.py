"""White and slow noise whose news has heavy tails: single readings that are far off count less.

As `slow`, with (r_i - E[r_i | before]) / sd[r_i | before] ~ t_nu for each average of samples.
"""

from shj_bayes.model.noise.noise import SLOW, TAU, WHITE, Noise, NoiseComponents, NoiseParameter, Values, exponential

NU = NoiseParameter("nu", "1", "degrees of freedom of the noise (large is Gaussian)", (4.0, 30.0), (5.0,), 10.0)


def parts(values: Values) -> NoiseComponents:
    """As `slow`, with Student's t for what is new in each sample."""
    return NoiseComponents(values["sigma_white"], values["sigma_slow"], values["nu"])


NOISE = Noise(id="student", own=(WHITE, SLOW, TAU, NU), parts=parts, decay=exponential)
