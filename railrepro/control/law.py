"""The control law of the 1 kHz exchange as one function: estimates, adhesion law, lateral law, integration rule.

A slower lateral controller (MPC) hands in `held` differential torques; with `ndi.active` the inversion runs here.
All gains are run-time inputs, so one compiled object serves every controller, scenario and tuning particle.

Serves the paper's Fig. 4 and sections Adhesion Control and Integration Approach.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import casadi as ca
import numpy as np

from railrepro.car import equations
from railrepro.clock import EXCHANGE_PERIOD
from railrepro.control.adhesion import AdhesionSettings, base_torque
from railrepro.control.allocation import allocate
from railrepro.control.ndi import NDISettings, differential_torque
from railrepro.track import route
from railrepro.vehicle.parameters import Vehicle

GEARS = ("front", "rear")
SIDES = ("le", "ri")
MODEL = ("J_eff", "k_sz", "k_dz", "J_Wy", "r0", "b", "gamma", "tan_delta", "mass")
LIMITS = ("lateral", "track_end", "stop_speed")
GAINS = (
    "ndi.active",
    *NDISettings().gains(),
    *AdhesionSettings().gains(),
    "adhesion.torque_per_adhesion",
    "estimate.noise_f",
    "estimate.noise_s",
    "estimate.bias_f",
    "estimate.bias_s",
    "estimate.lag",
    "tau_max",
    "fixed_share",
    "nominal_load",
    *(f"model.{name}" for name in MODEL),
    *(f"limit.{name}" for name in LIMITS),
)
MEMORY = (
    "ticks",
    *(f"{gear}.{name}" for gear in GEARS for name in ("u", "f_0", "f_1", "s_0", "s_1", "integral")),
    *(f"{gear}.{kind}_{i}" for gear in GEARS for kind in ("f_hat", "s_hat") for i in range(2)),
)
GUIDANCE_FADE = 1.0
"""Speed below which the differential torque fades (m/s): a wheel that stands cannot steer."""
_RECORDED = ("u_d", "du", "tau_long", "f_star", "segment", "y_ref")
RECORD = tuple(f"{gear}.{name}" for gear in GEARS for name in _RECORDED)


@dataclass(frozen=True)
class EstimateSettings:
    """Quality of the adhesion and slip estimates that the adhesion law sees.

    Attributes
    ----------
    noise_f, noise_s : float
        Standard deviation of white noise per exchange (-).
    bias_f, bias_s : float
        Relative error of scale (-).
    lag : float
        Time constant of a first-order lag (s).
    """

    noise_f: float = 0.0
    noise_s: float = 0.0
    bias_f: float = 0.0
    bias_s: float = 0.0
    lag: float = 0.0

    def gains(self) -> dict[str, float]:
        """Run-time gains by name."""
        return {f"estimate.{name}": float(value) for name, value in vars(self).items()}


def gain_vector(
    vehicle: Vehicle,
    ndi: NDISettings | None = None,
    adhesion: AdhesionSettings | None = None,
    estimate: EstimateSettings | None = None,
    fixed_share: float = 0.0,
    **limits: float,
) -> np.ndarray:
    """Run-time gains in the order of `GAINS`, shape (len(GAINS),).

    Parameters
    ----------
    vehicle : Vehicle
        Nominal vehicle that the controllers believe in.
    ndi : NDISettings, optional
        Given, the inversion guides; otherwise the held differential torque does.
    adhesion, estimate : optional
        Settings of the adhesion law and of its estimates.
    fixed_share : float
        See `allocate`.
    limits : float
        lateral (m), track_end (m), stop_speed (m/s): where a run ends.
    """
    load = (vehicle.body.mass / 2 + vehicle.gear.mass) * vehicle.gravity / 2
    gains = {"ndi.active": float(ndi is not None), "fixed_share": fixed_share}
    gains |= (ndi or NDISettings()).gains() | (adhesion or AdhesionSettings()).gains()
    gains |= (estimate or EstimateSettings()).gains()
    gains |= {"tau_max": vehicle.drive.torque_limit, "nominal_load": load}
    gains["adhesion.torque_per_adhesion"] = load * vehicle.wheel.radius
    gains |= {
        "model.J_eff": vehicle.effective_yaw_inertia,
        "model.k_sz": vehicle.suspension.yaw_stiffness,
        "model.k_dz": vehicle.suspension.yaw_damping,
        "model.J_Wy": vehicle.wheel.spin_inertia,
        "model.r0": vehicle.wheel.radius,
        "model.b": vehicle.gear.contact_base,
        "model.gamma": vehicle.gamma,
        "model.tan_delta": np.tan(vehicle.wheel.cone_angle),
        "model.mass": vehicle.effective_longitudinal_mass,
    }
    gains |= {f"limit.{name}": value for name, value in limits.items()}
    return np.array([gains[name] for name in GAINS])


@lru_cache(maxsize=1)
def law() -> ca.Function:
    """The 1 kHz law.

    Returns
    -------
    casadi.Function
        (y, rows, held[2], gains, memory) -> command[4] (N m), memory, record, margins; a run goes on while all margins
        (`LIMITS`, lateral twice: front, rear) are positive.
    """
    outputs = equations.car().outputs
    y_, rows = ca.SX.sym("y", len(outputs)), ca.SX.sym("rows", len(route.COLUMNS), 3)
    held, gains, memory = (
        ca.SX.sym("held", 2),
        ca.SX.sym("gains", len(GAINS)),
        ca.SX.sym("memory", len(MEMORY)),
    )
    y = dict(zip(outputs, ca.vertsplit(y_), strict=True))
    gain = dict(zip(GAINS, ca.vertsplit(gains), strict=True))
    old = dict(zip(MEMORY, ca.vertsplit(memory), strict=True))
    model = {name: gain[f"model.{name}"] for name in MODEL}
    cells = {gear: dict(zip(route.COLUMNS, ca.vertsplit(rows[:, 1 + g]), strict=True)) for g, gear in enumerate(GEARS)}
    roads = {gear: _road(cells[gear], y[f"{gear}.p"]) for gear in GEARS}
    heading = {name: (roads["front"][name] + roads["rear"][name]) / 2 for name in ("psi_Tr", "kappa")}

    new, record, command = {"ticks": old["ticks"] + 1}, {}, []
    for g, gear in enumerate(GEARS):
        road = roads[gear] | {"psi_CB": heading["psi_Tr"], "kappa_CB": heading["kappa"]}
        estimates = _estimates(gear, g, y, old, gain)
        new |= {f"{gear}.{kind}_{i}": value for (kind, i), value in estimates.items()}
        f_star = cells[gear]["force"] / (2 * gain["nominal_load"])
        own = {name: old[f"{gear}.{name}"] for name in ("u", "f_0", "f_1", "s_0", "s_1")}
        f, s = ([estimates[kind, i] for i in range(2)] for kind in ("f_hat", "s_hat"))
        u_d, kept, segment = base_torque(f, s, f_star, own, gain, gain["tau_max"])
        new |= {f"{gear}.{name}": value for name, value in kept.items()}
        state = {name: y[f"{gear}.{name}"] for name in ("v", "y", "psidot_Ax", "psi_Ax")}
        state |= {"psi_r": y[f"{gear}.psi_TrAx"], "vdot": 2 * u_d / (model["r0"] * model["mass"])}
        inverse = differential_torque(state, road, old[f"{gear}.integral"], gain, model)
        wanted = ca.if_else(gain["ndi.active"], inverse, held[g]) * _fade(state["v"], GUIDANCE_FADE)
        tau_le, tau_ri, tau_long, du = allocate(u_d, wanted, gain["tau_max"], gain["fixed_share"])
        command += [tau_le, tau_ri]
        free = ca.fabs(wanted) < gain["tau_max"]
        error = road["y0"] - state["y"]
        new[f"{gear}.integral"] = old[f"{gear}.integral"] + ca.if_else(free, EXCHANGE_PERIOD * error, 0)
        values = (u_d, du, tau_long, f_star, segment, road["y0"])
        record |= {f"{gear}.{name}": value for name, value in zip(_RECORDED, values, strict=True)}
    margins = [gain["limit.lateral"] - ca.fabs(y[f"{gear}.y"]) for gear in GEARS]
    margins += [gain["limit.track_end"] - y["front.p"], y["front.v"] - gain["limit.stop_speed"]]
    results = [
        ca.vertcat(*command),
        ca.vertcat(*(new[name] for name in MEMORY)),
        ca.vertcat(*(record[name] for name in RECORD)),
        ca.vertcat(*margins),
    ]
    return ca.Function(
        "fast_law",
        [y_, rows, held, gains, memory],
        [ca.densify(result) for result in results],
        ["y", "rows", "held", "gains", "memory"],
        ["command", "memory_next", "record", "margins"],
        {"cse": True},
    )


def _fade(v: ca.SX, speed: float) -> ca.SX:
    """0 at rest, 1 from `speed` (m/s) on."""
    return ca.fmin(ca.fmax(v / speed, 0), 1)


def _road(cell: dict, p: ca.SX) -> dict:
    """Track and set point at a gear from its cell."""
    psi, kappa, _, dphi, *_ = route.track_in(cell, p)
    y0, y1, y2 = route.reference_in(cell, p)
    track = {"psi_Tr": psi, "kappa": kappa, "dkappa": cell["dkappa"], "dphi": dphi}
    return track | {"y0": y0, "y1": y1, "y2": y2, "y3": cell["dddy_ref"]}


def _estimates(gear: str, g: int, y: dict, old: dict, gain: dict) -> dict:
    """Adhesion and slip estimates of both wheels: scaled, noisy and lagging copies of the plant's values."""
    estimates = {}
    pole = EXCHANGE_PERIOD / (gain["estimate.lag"] + EXCHANGE_PERIOD)
    for i, side in enumerate(SIDES):
        for k, (kind, name, short) in enumerate((("f_hat", "fx", "f"), ("s_hat", "sx", "s"))):
            exact = y[f"{gear}_{side}.{name}"] * (1 + gain[f"estimate.bias_{short}"])
            noise = gain[f"estimate.noise_{short}"] * white_noise(old["ticks"], 1 + 4 * g + 2 * i + k)
            before = old[f"{gear}.{kind}_{i}"]
            estimates[kind, i] = before + pole * (exact + noise - before)
    return estimates


def white_noise(ticks: ca.SX, channel: int) -> ca.SX:
    """Deterministic noise of unit variance: sum of three hashed uniform numbers of the tick and channel."""
    total = 0
    for k in range(3):
        hashed = ca.sin(12.9898 * (ticks + 1) + 78.233 * (3 * channel + k)) * 43758.5453
        total += hashed - ca.floor(hashed) - 0.5
    return 2 * total
