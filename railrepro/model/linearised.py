"""The yaw equation of the control-oriented model to first order, which inversion and stability are understood with.

Serves the paper's section Control-Oriented Model.
"""

from __future__ import annotations

from functools import lru_cache

import sympy as sp

from railrepro.model import derivation as d


@lru_cache
def yaw_equation(discrepancies: frozenset[str] = frozenset()) -> dict[str, sp.Expr]:
    """Coefficients of the yaw equation about straight centred running at speed v.

    Returns
    -------
    dict
        "inertia" multiplies psidd; "torque" the differential torque; "psi", "psid", "y", "roll rate" the deviations;
        all for the form inertia * psidd = sum of coefficient * quantity.
    """
    found, v = d.equations(discrepancies), sp.Symbol("v")
    small = (d.psi, d.psid, d.y, d.yd, d.psi_Tr, d.kappa, d.phi_Tr, d.dphi, d.psi_CB, d.kappa_CB, *d.torques)
    straight = dict.fromkeys(small, 0) | {d.xd: v}

    def slope(quantity: sp.Symbol) -> sp.Expr:
        return sp.expand(-sp.diff(found.rest[1], quantity).subs(straight))

    return {
        "inertia": sp.expand(found.mass[1, 1].subs(straight)),
        "torque": slope(d.tau_le) - slope(d.tau_ri),
        "psi": slope(d.psi),
        "psid": slope(d.psid),
        "y": slope(d.y),
        "roll rate": sp.expand(slope(d.dphi) / v),
    }
