"""Forces between the car body and a wheel carrier: springs, dampers, traction link, stops.

Serves the paper's section Simulation Environment; the control model keeps only k_sz, k_dz, k_sx and k_dx of it.
"""

from __future__ import annotations

import casadi as ca

from railrepro.car.integrator import Stages
from railrepro.car.kinematics import Body

_SINE = {"roll": (2, 1), "pitch": (0, 2), "yaw": (1, 0)}
"""Row and column of a rotation matrix where the sine of an angle stands, the other angles being small."""


def _beyond(value: ca.SX, clearance: ca.SX) -> ca.SX:
    """How far `value` exceeds +-clearance, signed."""
    return ca.fmax(value - clearance, 0) + ca.fmin(value + clearance, 0)


class Suspension:
    """Springs, dampers, traction link and stops between the car body and one carrier, in carrier axes.

    Attachment points coincide at rest, and both bodies feel a force at the body-side point, so that no angular momentum
    leaks. The moment on the car body is collected in carrier axes about its centre of gravity. `end` is +1 for the
    front carrier, -1 for the rear one.

    Source: eqs. (Lagrangeb) and (Lagrangec) are its yaw and roll terms for small angles.
    """

    def __init__(self, body: Body, gear: Body, end: int, par: dict[str, ca.SX], stages: Stages):
        self._par = par
        relative = gear.attitude.T @ body.attitude
        offset = gear.attitude.T @ (body.position - gear.position)
        velocity = gear.attitude.T @ (body.section.rotation @ body.v - gear.section.rotation @ gear.v)
        held = stages.hold(relative, offset, velocity, relative @ body.w)
        self._relative, self._offset, self._velocity, self._body_turn = held
        self._gear_turn = gear.w
        self._force, self._on_gear, self._on_body = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3)
        self.energy, self.dissipation = 0, 0
        half = end * par["body.gear_spacing"] / 2
        self._spring_pair(half)
        self._link(half)
        self._torsion_spring("roll", self._own("antiroll_stiffness"), self._own("antiroll_damping"))
        self._torsion_spring("pitch", self._own("pitch_stiffness"), self._own("pitch_damping"))
        self._torsion_spring("yaw", self._own("yaw_stop_stiffness"), 0, self._own("yaw_stop_angle"))
        self.yaw_sine = -self._relative[_SINE["yaw"]]
        self.force_on_gear, self.moment_on_gear = self._force, self._on_gear
        self.force_on_body, self.moment_on_body = -self._force, -self._relative.T @ self._on_body

    def _own(self, name: str) -> ca.SX:
        return self._par[f"suspension.{name}"]

    def _deflection(self, on_body: ca.SX, on_gear: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Arm on the body, relative displacement of two points and its rate, all in carrier axes."""
        arm = self._relative @ on_body
        deflection = self._offset + arm - on_gear
        rate = self._velocity + ca.cross(self._body_turn, arm) - ca.cross(self._gear_turn, arm + self._offset)
        return arm, deflection, rate

    def _act(self, arm: ca.SX, force: ca.SX) -> None:
        """Force on the gear (and its reaction on the body) at the body-side point."""
        self._force += force
        self._on_body += ca.cross(arm, force)
        self._on_gear += ca.cross(arm + self._offset, force)

    def _spring_pair(self, half: ca.SX) -> None:
        """Left and right spring and damper with lateral bump stop: their mean at the centre and their difference."""
        par, own = self._par, self._own
        stiffness = ca.vertcat(own("k_x"), own("k_y"), own("k_z"))
        damping = ca.vertcat(own("c_x"), own("c_y"), own("c_z"))
        preload = ca.vertcat(0, 0, par["body.mass"] * par["gravity"] / 2)
        on_body = ca.vertcat(half, 0, par["body.cg_height"] - own("height"))
        arm, mean, rate = self._deflection(on_body, ca.vertcat(0, 0, par["wheel.radius"] - own("height")))
        over = _beyond(mean[1], own("bump_clearance"))
        self._act(
            arm,
            preload + 2 * stiffness * mean + 2 * damping * rate + ca.vertcat(0, own("bump_stiffness") * over, 0),
        )
        lever = own("half_spacing") * self._relative[:, 1]
        difference = lever - ca.vertcat(0, own("half_spacing"), 0)
        difference_rate = ca.cross(self._body_turn - self._gear_turn, lever)
        couple = 2 * ca.cross(lever, stiffness * difference + damping * difference_rate)
        self._on_body += couple
        self._on_gear += couple
        self.energy += ca.dot(stiffness, mean**2 + difference**2) + ca.dot(preload, mean)
        self.energy += own("bump_stiffness") * over**2 / 2
        self.dissipation += 2 * ca.dot(damping, rate**2 + difference_rate**2)

    def _link(self, half: ca.SX) -> None:
        """Traction link at axle height; acts along the carrier only."""
        par, own = self._par, self._own
        on_body = ca.vertcat(half, 0, par["body.cg_height"] - par["wheel.radius"])
        arm, deflection, rate = self._deflection(on_body, ca.SX.zeros(3))
        force = own("link_stiffness") * deflection[0] + own("link_damping") * rate[0]
        self._act(arm, ca.vertcat(force, 0, 0))
        self.energy += own("link_stiffness") * deflection[0] ** 2 / 2
        self.dissipation += own("link_damping") * rate[0] ** 2

    def _torsion_spring(self, angle: str, stiffness, damping, free=None) -> None:
        """Torque with the potential k e^2/2 of the sine e of a relative angle, or of its excess over `free` (rad)."""
        row, column = _SINE[angle]
        sine = self._relative[row, column]
        gradient = ca.cross(self._relative[:, column], ca.SX.eye(3)[:, row])
        over = sine if free is None else _beyond(sine, ca.sin(free))
        rate = ca.dot(gradient, self._body_turn - self._gear_turn)
        torque = (stiffness * over + damping * rate) * gradient
        self._on_gear += torque
        self._on_body += torque
        self.energy += stiffness * over**2 / 2
        self.dissipation += damping * rate**2
