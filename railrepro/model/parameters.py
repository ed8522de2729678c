"""Names of the parameters of the control model, and discrepancies between its printed and corrected form. Serves the
paper's section Control-Oriented Model."""

from __future__ import annotations

DISCREPANCIES = ("D1", "D2", "D3", "D4", "D7")
"""Errata of data/discrepancies.csv that a variant of the model can keep; D4 concerns the forecast only."""

PARAMETERS = ("m", "m_x", "J_x", "J_z", "J_Wy", "J_Wz", "r_0", "b", "delta_0", "k_sz", "k_dz", "k_sx", "k_dx", "g")
"""Mass, longitudinal mass without body share (kg), residual and wheel inertias (kg m2), wheel radius, contact base (m),
cone angle (rad), stiffness and damping in yaw and roll (N m/rad, N m s/rad), gravity (m/s2)."""
