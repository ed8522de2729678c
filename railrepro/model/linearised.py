"""The yaw equation of the control-oriented model to first order, which inversion and stability are understood with.

Serves the paper's section Control-Oriented Model.
"""

from __future__ import annotations

import sympy as sp

from railrepro.model import derivation as d


def yaw_equation(discrepancies: frozenset[str] = frozenset()) -> dict[str, sp.Expr]:
    """Coefficients of the yaw equation about straight centred running at speed v.

    Returns
    -------
    dict
        "inertia" multiplies psidd; "torque" the differential torque; "psi", "psid", "y", "roll rate" the deviations;
        all for the form inertia * psidd = sum of coefficient * quantity.
    """
    found, v, du = d.equations(discrepancies), sp.Symbol("v"), sp.Symbol("du")
    centred = (d.psi, d.psid, d.y, d.yd, d.psi_Tr, d.kappa, d.phi_Tr, d.dphi, d.psi_CB, d.kappa_CB)
    straight = dict.fromkeys(centred, 0) | {d.xd: v}
    rest = -found.rest[1]

    def deviation(quantity: sp.Symbol) -> sp.Expr:
        slope = sp.diff(rest, quantity).subs(straight)
        return sp.simplify(slope.subs({d.tau_ri: 0, d.tau_le: 0}))

    return {
        "inertia": sp.simplify(found.mass[1, 1].subs(straight)),
        "torque": sp.simplify(rest.subs(straight).subs({d.tau_ri: -du, d.tau_le: du}).diff(du)),
        "psi": deviation(d.psi),
        "psid": deviation(d.psid),
        "y": deviation(d.y),
        "roll rate": sp.simplify(deviation(d.dphi) / v),
    }
