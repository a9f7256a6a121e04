"""Bounds as a table that link elements of structural programs take by hand, with a help line for each column."""

from collections.abc import Sequence

import pandas as pd
from scipy import optimize
from scipy.special import hyp2f1

from shj_bayes.margins.bounds import Bound
from shj_bayes.margins.opensees import HARDENING, plain
from shj_bayes.population.results import safe_cell

LARGEST_EXPONENT = 20.0
"""Programs with a Wen link refuse, or stumble over, sharper knees than this."""
HELP = {
    "set": "set of devices; (any set) is one never tested",
    "bound": "lower, middle or upper: run the lower and the upper analysis at least",
    "devices": "tested devices behind the numbers",
    "stiffness_kN_per_mm": "initial (elastic) stiffness of the link along its sliding direction",
    "stiffness_kN_per_m": "the same, where the program wants metres",
    "yield_force_kN": "sliding force; called yield force or yield strength in plastic (Wen) links",
    "post_yield_ratio": "post-yield stiffness over initial stiffness: next to 0, friction does not harden",
    "wen_exponent": "yielding exponent of a plastic (Wen) link; bilinear links do without",
    "effective_stiffness_kN_per_mm": "secant stiffness of the stated cycle, for linear analysis cases",
    "effective_damping": "equivalent viscous damping ratio of the stated cycle, for linear analysis cases",
}


def wen_exponent(beta: float) -> float:
    """Exponent of dz/du = 1 - z^n for which the monotonic curve passes the knee of Eq. (1): z(1) = 2^(-1/beta).

    u = z 2F1(1, 1/n; 1 + 1/n; z^n) is the displacement, over F/K, at which a Wen link carries z F.
    """
    knee = 2.0 ** (-1.0 / beta)

    def short_by(n: float) -> float:
        return float(knee * hyp2f1(1.0, 1.0 / n, 1.0 + 1.0 / n, knee**n)) - 1.0

    if short_by(LARGEST_EXPONENT) > 0:
        return LARGEST_EXPONENT
    if short_by(1.0) < 0:
        return 1.0
    return float(optimize.brentq(short_by, 1.0, LARGEST_EXPONENT))


def link_table(bounds: Sequence[Bound]) -> pd.DataFrame:
    """One line per set and bound; columns as in ``HELP``."""
    rows = [
        (
            safe_cell(b.set_name),
            b.bound,
            b.n_devices,
            float(f"{b.K_kN_mm:.5g}"),
            float(f"{1000.0 * b.K_kN_mm:.5g}"),
            float(f"{b.force_kN:.5g}"),
            HARDENING,
            round(wen_exponent(b.beta), 1),
            float(f"{b.stiffness_kN_mm:.5g}"),
            round(b.damping, 4),
        )
        for b in bounds
    ]
    return pd.DataFrame(rows, columns=list(HELP))


def link_csv(bounds: Sequence[Bound], cycle: str, left_out: Sequence[str] = ()) -> str:
    """Table as CSV under its help lines, which start with # (as comments do)."""
    head = [f"# {column}: {words}" for column, words in HELP.items()]
    head.append(f"# cycle of the last two columns: {cycle}. Not carried: speed, loss of force with travel, slot end.")
    head += [f"# {plain(note)}" for note in left_out]
    return "\n".join(head) + "\n" + link_table(bounds).to_csv(index=False, lineterminator="\n")
