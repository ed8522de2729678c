"""What the controllers know of a running gear: its true states, or what sensors and filter make of them.

Serves the paper's Fig. 4 and the measured states of eq. (18).
"""

from __future__ import annotations

from typing import Any

import casadi as ca

from railrepro.clock import CONTROL_PERIOD
from railrepro.control import interface
from railrepro.estimation import observers
from railrepro.estimation.sensors import SensorMemory, Signals, received_torque, sense
from railrepro.model.control_model import States
from railrepro.quantities import GEARS, SIDES, WHEELS, pack
from railrepro.track.route import irregularity_in, reference_in, track_in


class MeasuredGear:
    """One gear whose controllers get its true states, adhesion and slip."""

    def __init__(self, g: int, measured: Any, cell: dict[str, ca.SX], gain: Any, memory: Any):
        self.cell, self.gain = cell, gain
        self.truth = States(*pack(getattr(measured, GEARS[g])))
        self.wheels = [getattr(measured, wheel) for wheel in WHEELS[2 * g : 2 * g + 2]]
        self.memory, self.ticks, self.position = getattr(memory, GEARS[g]), memory.ticks, self.truth.x

    def look(self, track: Any) -> tuple[Any, list, list]:
        """States, and adhesion and slip of the wheels."""
        return self.truth, [wheel.adhesion for wheel in self.wheels], [wheel.sx for wheel in self.wheels]

    def send(self, torques: list, track: Any) -> tuple[list, dict[str, Any]]:
        """Torques that reach the motors in this cycle (N m), and what the memory keeps of sensors and filter."""
        return torques, {}


class SensedGear(MeasuredGear):
    """The same through sensors and filter; torques arrive late."""

    def __init__(self, g: int, measured: Any, cell: dict[str, ca.SX], gain: Any, memory: Any):
        super().__init__(g, measured, cell, gain, memory)
        truth, (left, right) = self.truth, self.wheels
        self._sensor = getattr(gain, GEARS[g])
        rail, rail_yaw = irregularity_in(cell, "lateral", truth.x)
        offset = truth.y_TrAx - rail
        lever = self._sensor.base / 2 * (truth.psi_TrAx - rail_yaw)
        exact = Signals(offset + lever, offset - lever, truth.psidot_Ax, left.w, right.w, truth.xdot, truth.x)
        self._readings, self._lines = sense(exact, self.ticks, g, self._sensor, self.memory.sensor)
        self.position = self._readings.p + CONTROL_PERIOD * self._sensor.command * self._readings.v

    def look(self, track: Any) -> tuple[Any, list, list]:
        """See `MeasuredGear.look`."""
        sensor, lines, readings, gain = self._sensor, self.memory.sensor, self._readings, self.gain
        sent_before = {"le": lines.tau_le[:-1], "ri": lines.tau_ri[:-1]}
        found, self._filter = observers.observe(
            readings, sent_before, track, self.ticks, sensor, gain, self.memory.filter
        )
        heading = track.psi_Tr + found.psi_TrAx
        state = States(self.position, heading, found.xdot, found.psidot_Ax, found.y_TrAx, found.psi_TrAx)
        planes = readings.y_ahead, readings.y_behind
        read = interface.ReadGear(sum(planes) / 2, (planes[0] - planes[1]) / sensor.base, readings.psidot_Ax)
        self._stored = {"estimated": state, "read": read}
        return state, found.f, found.s

    def send(self, torques: list, track: Any) -> tuple[list, dict[str, Any]]:
        """See `MeasuredGear.send`."""
        before = self.memory.sensor.tau_le, self.memory.sensor.tau_ri
        lines = [[torque, *line[:-1]] for torque, line in zip(torques, before, strict=True)]
        sent = dict(zip(SIDES, lines, strict=True))
        following = observers.advance(self._filter, sent, track, self._sensor, self.gain)
        memory = SensorMemory(**self._lines, tau_le=lines[0], tau_ri=lines[1])
        stored = {"sensor": memory, "filter": following, **self._stored}
        return [received_torque(line, self._sensor) for line in lines], stored


def track_ahead(cell: dict, p: ca.SX) -> dict[str, ca.SX]:
    """Track and set point at a gear from its cell, but for the car body's heading; see `lateral.ROAD`."""
    psi, kappa, phi, dphi, eps, deps = track_in(cell, p)
    y_ref, dy_ref, ddy_ref = reference_in(cell, p)
    track = {"psi_Tr": psi, "dpsi_dp": kappa, "ddpsi_dp": cell["dkappa"]}
    track |= {"phi_Tr": phi, "dphi_dp": dphi, "eps_Tr": eps, "deps_dp": deps}
    return track | {"y_ref": y_ref, "dy_ref": dy_ref, "ddy_ref": ddy_ref, "dddy_ref": cell["dddy_ref"]}
