"""White and slow noise whose news has heavy tails: single readings that are far off count less.

As `slow`, with (r_i - E[r_i | before]) / sd[r_i | before] ~ t_nu for each average of samples.
"""

from shj_bayes.model.noise.noise import Noise, NoiseComponents, Values, exponential


def parts(values: Values) -> NoiseComponents:
    """As `slow`, with Student's t for what is new in each sample."""
    return NoiseComponents(values["sigma_white"], values["sigma_slow"], values["nu"])


NOISE = Noise(id="student", parameters=("sigma_white", "sigma_slow", "tau_slow", "nu"), parts=parts, decay=exponential)
