"""One margin: a number with its unit, where it comes from, and what it is for."""

from __future__ import annotations

from dataclasses import dataclass, fields

from shj_bayes.errors import PopulationError

BANDS, TESTING, TOLERANCE, FACTORS = "new device", "EN 1990", "tolerance", "factor"
DESIGN, SPREAD = "design", "spread"
LOW, MIDDLE, HIGH = "low", "middle", "high"


@dataclass(frozen=True)
class Margin:
    """A margin of one set in one quantity.

    Parameters
    ----------
    set_name : str
        The set, or "(any set)" for one never tested.
    quantity : str
        A design quantity (lowest, highest, least, most, plateau, third, energy; ``_2`` and so on for later runs),
        ratio, degradation, K; or force, for what bounds the force of all runs.
    method : str
        design, new device, EN 1990, tolerance, factor or spread.
    kind : str
        What it is, in a few words.
    side : {"low", "middle", "high"}
        Which side of the typical value it bounds.
    value : float
        The number; NaN where it cannot be given, with the reason in ``note``.
    unit : str
        Its unit, "1" for none.
    n_devices : int
        Devices of the set (of all sets for one never tested).
    degrees : float
        Degrees of freedom of the spread; infinity where it is taken as known; NaN where the notion does not apply.
    clause, formula, inputs, purpose : str
        Clause, formula in words and signs, the numbers put into it, and what it is for.
    note : str
        What to mind.
    warning : str
        A few words that belong into the same cell as the value wherever it is shown; empty for none.
    """

    set_name: str
    quantity: str
    method: str
    kind: str
    side: str
    value: float
    unit: str
    n_devices: int
    degrees: float
    clause: str
    formula: str
    inputs: str
    purpose: str
    note: str = ""
    warning: str = ""

    def __post_init__(self) -> None:
        """Refuse a number without origin."""
        if self.side not in (LOW, MIDDLE, HIGH):
            raise PopulationError(f"a margin is low, middle or high, not {self.side!r}")
        if not (self.clause and self.formula and self.purpose and self.unit):
            raise PopulationError(
                f"the margin {self.kind!r} of {self.quantity} lacks a clause, formula, unit or purpose"
            )

    @property
    def key(self) -> tuple[str, str, str, str]:
        """What it is found by: set, quantity, kind, side."""
        return self.set_name, self.quantity, self.kind, self.side


COLUMNS = tuple(f.name for f in fields(Margin))
