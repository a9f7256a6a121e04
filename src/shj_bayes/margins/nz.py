"""Strength reduction and overstrength of the sliding hinge joint, as New Zealand practice writes them."""

from __future__ import annotations

from shj_bayes.errors import PopulationError

PRACTICE_PHI, PRACTICE_PHI_O = 0.70, 1.40
"""Values in use for high-hardness shims (Bisalloy 400 and harder), recalled from the AFC literature of 2012-14."""


def slip_capacity(bolts: int, friction: float, bolt_tension_kN: float, surfaces: int = 2) -> float:
    """Nominal sliding force V_ss = n_b n_s mu N_tf, kN."""
    if min(bolts, surfaces) < 1 or friction <= 0 or bolt_tension_kN <= 0:
        raise PopulationError(
            f"V_ss needs bolts, surfaces, friction and tension above zero; got {bolts}, {surfaces}, {friction:g}, "
            f"{bolt_tension_kN:g} kN"
        )
    return bolts * surfaces * friction * bolt_tension_kN


def equivalent_factors(low: float, high: float, nominal: float) -> tuple[float, float]:
    """Return phi = X_5% / nominal and phi_o = X_95% / nominal.

    Raises
    ------
    PopulationError
        If the nominal value is not above zero.
    """
    if nominal <= 0:
        raise PopulationError(f"a nominal sliding force must be above zero; got {nominal:g} kN")
    return low / nominal, high / nominal
