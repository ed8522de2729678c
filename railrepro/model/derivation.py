"""Symbolic derivation of the control-oriented model, as printed in the paper and corrected. The five coordinates are
path x, yaw angle psi, lateral displacement y and both wheel angles. Rolling and the lateral kinematics are
non-holonomic constraints on their rates, which leave two rates free. The corrected model is the projection of
Lagrange's equations on the free rates (Jourdain's principle). Errata are errors in the paper's equations. An argument
`discrepancies` is the set of errata that stay as printed, all others are corrected: "D1", the constraints are inserted
into the energies first; "D2", wheel energy; "D3", yaw rate in rolling; "D7", roll of the suspension. Other names have
no effect. Serves the paper's section Control-Oriented Model."""

from functools import lru_cache

import sympy as sp

from railrepro.model.parameters import PARAMETERS

m, m_x, J_x, J_z, J_Wy, J_Wz, r_0, b, delta_0, k_sz, k_dz, k_sx, k_dx, g = parameters = sp.symbols(
    " ".join(PARAMETERS), positive=True
)
x, psi, y, th_ri, th_le = coordinates = sp.symbols("x psi y theta_ri theta_le")
xd, psid, yd, thd_ri, thd_le = rates = sp.symbols(r"\dot{x} \dot{psi} \dot{y} \dot{theta}_ri \dot{theta}_le")
xdd, psidd = accelerations = sp.symbols(r"\ddot{x} \ddot{psi}")
psi_Tr, kappa, phi_Tr, dphi, eps_Tr, deps, psi_CB, kappa_CB, m_CB = theta = sp.symbols(
    "psi_Tr kappa phi_Tr phi_Tr' epsilon_Tr epsilon_Tr' psi_CB kappa_CB m_CB"
)
tau_ri, tau_le = torques = sp.symbols("tau_ri tau_le")

psi_r = psi - psi_Tr
gamma = sp.tan(delta_0) / (b / 2 - r_0 * sp.tan(delta_0))
roll, roll_rate = -gamma * y + phi_Tr, -gamma * yd + dphi * xd
height = delta_0 * b / 2 * (1 / sp.cos(psi_r) - 1) - gamma * y**2 - r_0
radius = {"ri": r_0 + sp.tan(delta_0) * y, "le": r_0 - sp.tan(delta_0) * y}
arm = {"ri": b / 2 - y, "le": b / 2 + y}


def along_track(expression: sp.Expr) -> sp.Expr:
    """Differentiate an expression by the path x. The angles of the track vary along x, their slopes do not."""
    return sp.diff(expression, x) + sp.diff(expression, psi_Tr) * kappa + sp.diff(expression, phi_Tr) * dphi


def time_derivative(expression: sp.Expr, rate_of_rates: dict) -> sp.Expr:
    """Differentiate an expression of coordinates and rates by time. `rate_of_rates` maps a rate to its derivative."""
    total = along_track(expression) * xd
    for coordinate, rate in zip(coordinates[1:], rates[1:], strict=True):
        total += sp.diff(expression, coordinate) * rate
    return total + sum(sp.diff(expression, rate) * change for rate, change in rate_of_rates.items())


def constraints(discrepancies: frozenset[str]) -> dict[sp.Symbol, sp.Expr]:
    """Constraints of lateral kinematics and ideal rolling: a dict from the dependent rates yd (m/s), thd_ri and thd_le
    (rad/s) to expressions in the free rates xd and psid. `discrepancies` names the printed errors that stay
    uncorrected; here "D3" acts: the turning rate of the track counts twice. Source: eqs. (9), (12)."""
    turning = psid + kappa * xd if "D3" in discrepancies else psid
    spin_ri = -(xd - arm["ri"] * turning) / radius["ri"]
    spin_le = -(xd + arm["le"] * turning) / radius["le"]
    return {yd: xd * sp.sin(psi_r), thd_ri: spin_ri, thd_le: spin_le}


def wheel_rotation(spin: sp.Expr) -> sp.Matrix:
    """Absolute angular velocity of a wheel (rad/s), shape (3, 1), in axes of the axle (roll, axle, yaw): that of the
    axle, by the roll and yaw symbols of this module, plus the rate `spin` of the wheel relative to it (rad/s)."""
    return sp.Matrix([roll_rate, spin + psid * sp.sin(roll), psid * sp.cos(roll)])


def kinetic_energy(discrepancies: frozenset[str]) -> sp.Expr:
    """Kinetic energy (J) of a running gear and half the car body as a function of all `rates`. `discrepancies` names
    the printed errors that stay uncorrected; here only "D2" acts: the wheels have the energy of the sum of their
    angular velocities. Source: eq. (13a)."""
    height_rate = sp.diff(height, psi) * (psid - kappa * xd) + sp.diff(height, y) * yd
    inertia = sp.diag(J_Wz, J_Wy, J_Wz)
    w_ri, w_le = wheel_rotation(thd_ri), wheel_rotation(thd_le)
    if "D2" in discrepancies:
        wheels = ((w_ri + w_le).T * inertia * (w_ri + w_le))[0]
    else:
        wheels = (w_ri.T * inertia * w_ri)[0] + (w_le.T * inertia * w_le)[0]
    carried = (m_x + m_CB / 2) * xd**2 + m * (yd**2 + height_rate**2)
    return (carried + J_z * psid**2 + J_x * roll_rate**2 + wheels) / 2


def potential_energy(discrepancies: frozenset[str]) -> sp.Expr:
    """Potential energy (J) of springs and weight. `discrepancies` names the printed errors that stay uncorrected; here
    only "D7" acts: the roll spring deflects by the absolute roll, not by that against the track. Source: eq. (13b)."""
    deflection = roll if "D7" in discrepancies else roll - phi_Tr
    return (k_sz * (psi - psi_CB) ** 2 + k_sx * deflection**2) / 2 - m * g * height


def dissipation(discrepancies: frozenset[str]) -> sp.Expr:
    """Rayleigh dissipation (W), half the power lost in dampers. `discrepancies` names the printed errors that stay
    uncorrected; here only "D7" acts: the roll damper sees the absolute roll rate. Source: eq. (13c)."""
    deflection_rate = roll_rate if "D7" in discrepancies else -gamma * yd
    return (k_dz * (psid - kappa_CB * xd) ** 2 + k_dx * deflection_rate**2) / 2


def generalised_forces() -> tuple[sp.Expr, sp.Expr]:
    """Force along x (N) and moment about z (N m) of motor torques, positive in traction, unlike in eq. (17)."""
    pull = {"ri": tau_ri / radius["ri"], "le": tau_le / radius["le"]}
    return pull["ri"] + pull["le"], arm["le"] * pull["le"] - arm["ri"] * pull["ri"]


def lagrange(coordinate: sp.Symbol, rate: sp.Symbol, energies: tuple, rate_of_rates: dict) -> sp.Expr:
    """Left side of Lagrange's equation (16b) of one coordinate and its rate (N or N m). `energies` are kinetic energy,
    potential energy and dissipation. `rate_of_rates` maps each rate to its derivative."""
    t, v, d = energies
    by_t, by_v = (along_track(e) if coordinate == x else sp.diff(e, coordinate) for e in (t, v))
    return time_derivative(sp.diff(t, rate), rate_of_rates) - by_t + by_v + sp.diff(d, rate)


def derivatives_first(energies: tuple, dependent: dict) -> sp.Matrix:
    """Corrected order of steps: Lagrange's equations of all five coordinates, then their projection on the two free
    rates, shape (2, 1). `energies` are kinetic, potential, dissipation; `dependent` is from `constraints`."""
    free = {xd: xdd, psid: psidd}
    changes = free | {rate: time_derivative(e, free).subs(yd, dependent[yd]) for rate, e in dependent.items()}
    total = sp.zeros(2, 1)
    for coordinate, rate in zip(coordinates, rates, strict=True):
        along = sp.Matrix([sp.diff(dependent.get(rate, rate), own) for own in free])
        total += lagrange(coordinate, rate, energies, changes) * along
    return total.subs(dependent)


def constraints_first(energies: tuple, dependent: dict) -> sp.Matrix:
    """Left sides of Lagrange's equations of path and yaw angle, shape (2, 1), by the paper's order of steps (its error
    D1): the constraints are inserted into the `energies` (kinetic, potential, dissipation) before Lagrange's equations
    are applied. `dependent` maps each dependent rate to its expression, from `constraints`."""
    t, v, d = energies
    reduced, free = (t.subs(dependent), v, d.subs(dependent)), {xd: xdd, psid: psidd}
    return sp.Matrix([lagrange(q, rate, reduced, free) for q, rate in ((x, xd), (psi, psid))]).subs(dependent)


@lru_cache
def equations(discrepancies: frozenset[str] = frozenset()) -> tuple[sp.Matrix, sp.Matrix]:
    """Derive the equations of motion of a running gear with half the car body, M a + h = 0. a = (xdd, psidd) has the
    second time derivatives of the path x along the track and of the yaw angle psi. Returns the SymPy matrices M (2, 2)
    and h (2, 1). `discrepancies` has those errors in the paper's equations that stay uncorrected, of "D1", "D2", "D3",
    "D7" (beginning of this module); other names have no effect. Without it the model is the corrected one."""
    energies = tuple(energy(discrepancies) for energy in (kinetic_energy, potential_energy, dissipation))
    order = constraints_first if "D1" in discrepancies else derivatives_first
    residual = order(energies, constraints(discrepancies)) - sp.Matrix(generalised_forces())
    return residual.jacobian(sp.Matrix(accelerations)), residual.subs({xdd: 0, psidd: 0})
