"""What the 1 kHz control law measures, records and compares with limits: names and units. Serves the paper's Fig. 4."""

from __future__ import annotations

from railrepro.car.component import DERAILED
from railrepro.control import lateral
from railrepro.data import between
from railrepro.model.control_model import STATE_UNITS
from railrepro.model.parameters import PERMITTED
from railrepro.quantities import WHEELS, group, names

_DISPLACEMENT, _SPEED = between(-DERAILED, DERAILED, "m"), between(-1.0, 150.0, "m/s")
MeasuredGear = group(
    "MeasuredGear",
    {"p": between(-1e6, 1e6, "m"), "psi_Ax": between(-1e3, 1e3, "rad"), "v": _SPEED},
    {"psidot_Ax": between(-10.0, 10.0, "rad/s"), "y": _DISPLACEMENT, "psi_TrAx": between(-1.0, 1.0, "rad")},
)
MeasuredWheel = group(
    "MeasuredWheel",
    {"adhesion": between(-10.0, 10.0, "-"), "sx": between(-1e3, 1e3, "-"), "w": between(-1e4, 1e4, "rad/s")},
)
Measured = group("Measured", {"front": MeasuredGear, "rear": MeasuredGear}, dict.fromkeys(WHEELS, MeasuredWheel))
"""Outputs of the car that the law measures: states of both gears; adhesion, slip and angular speed of the wheels. An
exported controller refuses values out of these ranges; `p` has to be on its route, besides."""
GearMargin = group("GearMargin", "lateral m, torque -")
Margins = group("Margins", {"front": GearMargin, "rear": GearMargin}, "track_end m, stop_speed m/s")
"""Distances to the limits of a run, which goes on while all are positive: displacements, end of the track, speed.
`torque` is 1, or 0 where the lateral law gives no finite number, which the torque limit would hide."""
Limits = group("Limits", "lateral m, track_end m, stop_speed m/s")
"""Where a run ends: largest displacement of a gear, largest track coordinate and lowest speed of the front gear."""
ReadGear = group("ReadGear", "y_TrAx m, psi_TrAx rad, psidot_Ax rad/s")
"""Displacement (m), yaw angle against the track (rad) and yaw rate (rad/s) of a gear as its sensors read them."""
Record = group("Record", "u_d N m, du N m, tau_long N m, f_star -, segment -, y_ref m")
"""Log of one gear: base, differential and longitudinal torque, adhesion set point, segment 1 to 3 of the adhesion law,
and the lateral set point at the true position of the gear, from which errors are counted."""
EstimatedRecord = group("EstimatedRecord", STATE_UNITS, "f_le -, f_ri -, s_le -, s_ri -, y_ref m")
"""Further log of one gear with sensors: estimated states, adhesion and slip; set point at the estimated position."""
Model = group("Model", {name: PERMITTED[name] for name in lateral.MODEL if name != "tau_max"})
"""Numbers of the nominal vehicle: fields of `lateral.MODEL` but `tau_max`, which is the drive's."""
Track = group("Track", {name: unit for name, (unit, _) in lateral.ROAD.items()})
MEASURED, MARGINS = names(Measured), names(Margins)
