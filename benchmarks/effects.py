"""Time of the law with effects of the catalogue, one and any two of them, in units of the law without.

Run ``python benchmarks/effects.py`` (a minute). One run of Table 1 at 20 Hz, one parameter set a call, effects at a
third of a prior standard deviation.
"""

from __future__ import annotations

from itertools import combinations

import numpy as np
from devices import device
from timing import best

from shj_bayes.model.device import force_with_effects
from shj_bayes.model.effects.effect import Base, Effect, catalogue
from shj_bayes.model.law import force

BASE = Base(18.0, 80.0, 10.0, 1 / 60, 80.0)
LIMIT = 5.0


def values(effect: Effect) -> dict[str, float]:
    """Parameters a third of a standard deviation from the middle of their priors."""
    return {prior.name: float(prior.from_free(np.asarray(0.3))) for prior in effect.parameters}


def main() -> None:
    """Print the dearest, and how many pairs are above the aim."""
    history = device(20.0, BASE.beta).histories[0]
    n = history.time_s.size
    base = best(lambda: force(history.motion, K=BASE.K, Fy=BASE.Fy, beta=BASE.beta, gamma=BASE.gamma), 20)
    print(f"law alone {1e6 * base:.0f} us for {n} samples; times it, dearest first")
    for size in (1, 2):
        rows = []
        for chosen in combinations(catalogue().values(), size):
            acting = [(effect, values(effect)) for effect in chosen]
            seconds = best(lambda a=acting: force_with_effects(history, BASE, a), 4)  # type: ignore[misc]
            rows.append((seconds / base, " + ".join(effect.id for effect in chosen)))
        rows.sort(reverse=True)
        for ratio, name in rows[:6]:
            print(f"  {ratio:6.1f}  {name}")
        slow = [name for ratio, name in rows if ratio > LIMIT]
        median = np.median([ratio for ratio, _ in rows])
        print(f"  {size} effect(s): median {median:.1f}; above {LIMIT:g}: {len(slow)} of {len(rows)}", flush=True)


if __name__ == "__main__":
    main()
