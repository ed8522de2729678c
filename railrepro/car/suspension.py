"""Forces between car body and wheel carrier: springs, dampers, traction link, stops. Serves the paper's section
Simulation Environment; the control model has only k_sz, k_dz, k_sx and k_dx."""

from typing import Any

import casadi as ca

from railrepro.car.integrator import Stages
from railrepro.car.kinematics import Body

_SINE = {"roll": (2, 1), "pitch": (0, 2), "yaw": (1, 0)}
"""Angle -> row and column of its sine in a rotation matrix, if the other angles are small."""


def _beyond(value: ca.SX, clearance: ca.SX) -> ca.SX:
    """Return the signed excess of a value over the range from -clearance to +clearance, 0 within it."""
    return ca.fmax(value - clearance, 0) + ca.fmin(value + clearance, 0)


class Suspension:
    """Springs, dampers, traction link, torsion bars and stops between the car body and one wheel carrier.

    `body` (upper) is the car body, `lower` the wheel carrier, `end` +1 for the front one and -1 for the rear one, `par`
    an `equations.CarParameters`. `stages` puts symbols in place of deflections and forces, so that the Jacobian is
    cheap. A force acts on both bodies at the attachment point of the car body, so that angular momentum is conserved.
    The rods that carry the pitch reaction of the motors act about the cross product of the body's axis z and the
    carrier's axis x; with relative roll they also turn the carrier in yaw. Torsion springs act by the sine of an angle.
    Source: eqs. (13b), (13c) of the paper, which are linear and for yaw and roll alone; at small angles both agree.

    Attributes:
        force_on_lower, moment_on_lower (SX, shape (3, 1)): Force (N) and moment about the centre of gravity (N m) on
            the carrier, in its axes. The opposite force acts on the body.
        moment_on_upper (SX, shape (3, 1)): Moment on the car body in its axes (N m).
        energy, dissipation (SX): Potential energy (J), power lost in dampers (W).
        yaw_sine, sway (SX): Sine of the carrier's yaw angle against the body (-), lateral deflection (m).
    """

    def __init__(self, body: Body, lower: Body, end: int, par: Any, stages: Stages):
        relative = lower.attitude.T @ body.attitude
        offset = lower.attitude.T @ (body.position - lower.position)
        velocity = lower.attitude.T @ (body.section.rotation @ body.v - lower.section.rotation @ lower.v)
        held = stages.hold(relative, offset, velocity, relative @ body.w)
        self._relative, self._offset, self._velocity, self._upper_rate = held
        self._par, self._lower_rate = par, lower.w
        self.force_on_lower, self.moment_on_lower, self._on_upper = ca.SX.zeros(3), ca.SX.zeros(3), ca.SX.zeros(3)
        self.energy, self.dissipation = ca.SX(0), ca.SX(0)
        # ±½ and not ±1, which CasADi drops: both gears keep the same operations, see `compile.lanes`
        data, half = par.suspension, ca.SX(end / 2) * par.body.gear_spacing
        on_body = ca.vertcat(half, 0, par.body.cg_height - data.height)
        on_lower = ca.vertcat(0, 0, par.wheel.radius - data.height)
        arm, mean = self._spring_pair(on_body, on_lower, par.body.mass * par.gravity / 2)
        over = _beyond(mean[1], data.bump_clearance)
        self._act(arm, ca.vertcat(0, data.bump_stiffness * over, 0))
        self.energy += data.bump_stiffness * over**2 / 2
        self._link(half)
        self._torsion_spring("roll", data.antiroll_stiffness, data.antiroll_damping)
        self._torsion_spring("pitch", data.pitch_stiffness, data.pitch_damping)
        self._torsion_spring("yaw", data.yaw_stop_stiffness, 0, data.yaw_stop_angle)
        self.yaw_sine = -self._relative[_SINE["yaw"]]
        self.sway = mean[1]
        held = stages.hold(self.force_on_lower, self.moment_on_lower, self._on_upper)
        self.force_on_lower, self.moment_on_lower, on_upper = held
        self.moment_on_upper = -self._relative.T @ on_upper

    def _deflection(self, on_upper: ca.SX, on_lower: ca.SX) -> tuple[ca.SX, ca.SX, ca.SX]:
        """Return the lever arm of a point on the upper body, its displacement from one on the lower body, its rate."""
        arm = self._relative @ on_upper
        deflection = self._offset + arm - on_lower
        rate = self._velocity + ca.cross(self._upper_rate, arm) - ca.cross(self._lower_rate, arm + self._offset)
        return arm, deflection, rate

    def _act(self, arm: ca.SX, force: ca.SX) -> None:
        """Apply a force to the lower body, and its reaction to the upper one, at the point `arm` of the upper one."""
        self.force_on_lower += force
        self._on_upper += ca.cross(arm, force)
        self.moment_on_lower += ca.cross(arm + self._offset, force)

    def _spring_pair(self, on_upper: ca.SX, on_lower: ca.SX, preload: ca.SX) -> tuple[ca.SX, ca.SX]:
        """Apply springs and dampers left and right: their mean at the centre, and a couple from their difference. They
        carry the weight `preload` (N). Returns lever arm and mean deflection (m)."""
        data = self._par.suspension
        stiffness = ca.vertcat(data.k_x, data.k_y, data.k_z)
        damping = ca.vertcat(data.c_x, data.c_y, data.c_z)
        weight = ca.vertcat(0, 0, preload)
        arm, mean, rate = self._deflection(on_upper, on_lower)
        self._act(arm, weight + 2 * stiffness * mean + 2 * damping * rate)
        lever = data.half_spacing * self._relative[:, 1]
        difference = lever - ca.vertcat(0, data.half_spacing, 0)
        difference_rate = ca.cross(self._upper_rate - self._lower_rate, lever)
        couple = 2 * ca.cross(lever, stiffness * difference + damping * difference_rate)
        self._on_upper += couple
        self.moment_on_lower += couple
        self.energy += ca.dot(stiffness, mean**2 + difference**2) + ca.dot(weight, mean)
        self.dissipation += 2 * ca.dot(damping, rate**2 + difference_rate**2)
        return arm, mean

    def _torsion_spring(self, angle: str, stiffness, damping, free=None) -> None:
        """Apply a torque about the gradient of the sine of a relative angle: proportional to this sine, or for a stop
        to its excess over the play `free` (rad)."""
        row, column = _SINE[angle]
        sine = self._relative[row, column]
        gradient = ca.cross(self._relative[:, column], ca.SX.eye(3)[:, row])
        over = sine if free is None else _beyond(sine, ca.sin(free))
        rate = ca.dot(gradient, self._upper_rate - self._lower_rate)
        torque = (stiffness * over + damping * rate) * gradient
        self.moment_on_lower += torque
        self._on_upper += torque
        self.energy += stiffness * over**2 / 2
        self.dissipation += damping * rate**2

    def _link(self, half: ca.SX) -> None:
        """Apply the traction link at axle height, which acts along the carrier only."""
        par, data = self._par, self._par.suspension
        on_upper = ca.vertcat(half, 0, par.body.cg_height - par.wheel.radius)
        arm, deflection, rate = self._deflection(on_upper, ca.SX.zeros(3))
        force = data.link_stiffness * deflection[0] + data.link_damping * rate[0]
        self._act(arm, ca.vertcat(force, 0, 0))
        self.energy += data.link_stiffness * deflection[0] ** 2 / 2
        self.dissipation += data.link_damping * rate[0] ** 2
