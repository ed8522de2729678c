"""Names and units of the quantities that the 1 kHz control law measures, logs and limits. Serves the paper's Fig. 4."""

from dataclasses import dataclass
from typing import Annotated

from railrepro.car.outputs import GearStates
from railrepro.data import between
from railrepro.model.control_model import STATES
from railrepro.quantities import Scalar, names


@dataclass(frozen=True)
class MeasuredWheel:
    """What the control law measures of a wheel: adhesion (creep force over normal force), slip, angular speed."""

    adhesion: Annotated[Scalar, between(-10.0, 10.0, "-")]
    sx: Annotated[Scalar, between(-1e3, 1e3, "-"), "slip"]
    w: Annotated[Scalar, between(-1e4, 1e4, "rad/s"), "angular speed"]


@dataclass(frozen=True)
class Measured:
    """What the control law measures of the car: the state of both running gears; adhesion, slip and speed of each
    wheel. An exported controller refuses values out of range, and a track coordinate `p` that is not on its route."""

    front: GearStates
    rear: GearStates
    front_le: MeasuredWheel
    front_ri: MeasuredWheel
    rear_le: MeasuredWheel
    rear_ri: MeasuredWheel


@dataclass(frozen=True)
class Limits:
    """Limits at which a run ends: lateral displacement of a running gear, end of the track, lowest speed."""

    lateral: Annotated[Scalar, "m", "largest lateral displacement of a running gear"]
    track_end: Annotated[Scalar, "m", "largest track coordinate of the front running gear"]
    stop_speed: Annotated[Scalar, "m/s", "lowest speed of the front running gear"]


RECORD = ("u_d", "du", "tau_long", "f_star", "segment", "y_ref")
"""Names of the logged quantities of one running gear: base torque, differential torque, longitudinal torque (N m), set
point of the adhesion (-), segment of the adhesion law (1 to 3), lateral set point at the true position (m)."""
ESTIMATED = (*STATES, "f_le", "f_ri", "s_le", "s_ri", "y_ref")
"""Names of the logged inputs of the controllers of one running gear in a run with sensors: states of the control model,
adhesion and slip of left and right wheel (-), lateral set point at the estimated position (m)."""
READ = ("y_TrAx", "psi_TrAx", "psidot_Ax")
"""Names of the readings of one running gear: lateral displacement (m), yaw angle against the track (rad), yaw rate
(rad/s)."""
MEASURED = names(Measured)
MARGINS = ("front.lateral", "front.torque", "rear.lateral", "rear.torque", "track_end", "stop_speed")
"""Names of the distances to the limits of a run, which goes on while all are positive. "lateral" (m) is the distance to
the largest lateral displacement. "torque" is 1, or 0 if the lateral law gives no finite number before the torque limit.
"track_end" (m) is the distance of the front gear to the track end, "stop_speed" (m/s) its speed less the limit."""
