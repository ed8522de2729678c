"""Parameters of the control model with their ranges, and the errata that a variant of it can keep. Serves the paper's
section Control-Oriented Model."""

from dataclasses import replace

from railrepro.data import above, between
from railrepro.quantities import notes
from railrepro.vehicle.parameters import CarBody, Environment, Gear, Wheel

DISCREPANCIES = ("D1", "D2", "D3", "D4", "D7")
"""Errata of data/discrepancies.csv that a variant of the model can keep. D4 changes the forecast only."""

PARAMETERS = ("m", "m_x", "J_x", "J_z", "J_Wy", "J_Wz", "r_0", "b", "delta_0", "k_sz", "k_dz", "k_sx", "k_dx", "g")
"""Mass and longitudinal mass without the car body (kg), inertias without wheels and of a wheel (kg m2), wheel radius,
contact base (m), cone angle (rad), stiffness and damping in yaw and roll (N m/rad, N m s/rad), gravity (m/s2)."""

_body, _gear, _wheel, _world = (dict(notes(of)) for of in (CarBody, Gear, Wheel, Environment))
_stiffness, _damping = between(0.0, 1e10, "N m/rad"), between(0.0, 1e9, "N m s/rad")
PERMITTED = {"m": _gear["mass"], "m_x": _gear["mass"], "m_CB": _body["mass"], "m_x_eff": above(0.0, 1e11, "kg")}
PERMITTED |= {"J_x": _gear["inertia_x"], "J_z": _gear["inertia_z"], "J_eff": above(0.0, 1e11, "kg m2")}
PERMITTED |= {"J_Wy": _wheel["spin_inertia"], "J_Wz": _wheel["diametral_inertia"], "delta_0": _wheel["cone_angle"]}
PERMITTED |= {"r_0": _wheel["radius"], "b": _gear["contact_base"]}
PERMITTED |= {"partner": replace(_body["gear_spacing"], signed=True)}
PERMITTED |= {"tan_delta": between(0.0, 0.21, "-"), "gamma": between(0.0, 10.0, "rad/m"), "g": _world["gravity"]}
PERMITTED |= {"k_sz": _stiffness, "k_dz": _damping, "k_sx": _stiffness, "k_dx": _damping}
PERMITTED |= {"acceleration_per_torque": above(0.0, 1.0, "1/(kg m)", signed=True)}
"""Range of each number that control model, forecast and control law derive from a vehicle, by name. It is the range of
the field of `Vehicle`, or what vehicles within their ranges give."""
