"""Names of the parameters of the control model, and discrepancies between its printed and corrected form.

Serves the paper's section Control-Oriented Model.
"""

from __future__ import annotations

DISCREPANCIES = {
    "D1": "lateral constraint inserted into the kinetic energy before Lagrange (non-holonomic)",
    "D2": "wheel energy with cross terms, (w_ri + w_le)^T J (w_ri + w_le) / 2",
    "D3": "track yaw rate added to the absolute yaw rate in the wheel speeds",
    "D7": "absolute roll used as deflection of the roll suspension",
}

PARAMETERS = ("m", "m_x", "J_x", "J_z", "J_Wy", "J_Wz", "r_0", "b", "delta_0", "k_sz", "k_dz", "k_sx", "k_dx", "g")
"""Mass, longitudinal mass without body share (kg), residual and wheel inertias (kg m2), wheel radius, contact base (m),
cone angle (rad), stiffness and damping in yaw and roll (N m/rad, N m s/rad), gravity (m/s2)."""
