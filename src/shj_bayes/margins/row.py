"""One margin: a number with its unit, where it comes from, and what it is for."""

from dataclasses import dataclass, field

from shj_bayes.errors import PopulationError

BANDS, TESTING, TOLERANCE, FACTORS = "new device", "EN 1990", "tolerance", "factor"
DESIGN, SPREAD, USE = "design", "spread", "use"
LOW, MIDDLE, HIGH = "low", "middle", "high"
Key = tuple[str, str, str, str]
"""Set, quantity, kind, side."""


@dataclass(frozen=True)
class Margin:
    """A margin of one set in one quantity."""

    set_name: str  # the set, or "(any set)" for one never tested
    # a design quantity (lowest, highest, least, most, plateau, third, energy; ``_2`` and so on for later runs), ratio,
    # degradation, K; or force, for what bounds the force of all runs
    quantity: str
    method: str  # design, use, new device, EN 1990, tolerance, factor or spread
    kind: str  # what it is, in a few words
    side: str  # "low", "middle", "high": which side of the typical value it bounds
    value: float  # the number; NaN where it cannot be given, with the reason in ``note``
    unit: str  # its unit, "1" for none
    n_devices: int  # devices of the set (of all sets for one never tested)
    # degrees of freedom of the spread; infinity where it is taken as known; NaN where the notion does not apply
    degrees: float
    # clause to purpose: clause, formula in words and signs, the numbers put into it, and what it is for
    clause: str
    formula: str
    inputs: str
    purpose: str
    note: str = ""  # what to mind
    warning: str = ""  # a few words that belong into the same cell as the value wherever it is shown; empty for none
    # standard error of the value from the number of draws, in its unit
    monte_carlo_error: float = field(default=0.0, kw_only=True)

    def __post_init__(self) -> None:
        """Refuse a number without origin."""
        if self.side not in (LOW, MIDDLE, HIGH):
            raise PopulationError(f"a margin is low, middle or high, not {self.side!r}")
        if not (self.clause and self.formula and self.purpose and self.unit):
            raise PopulationError(
                f"the margin {self.kind!r} of {self.quantity} lacks a clause, formula, unit or purpose"
            )

    @property
    def key(self) -> Key:
        """What it is found by."""
        return self.set_name, self.quantity, self.kind, self.side
