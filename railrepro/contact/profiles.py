"""Profiles S1002 of the wheel and 60E1 of the rail, from the coefficients of the standards. Lateral coordinates are
positive to the field side, heights radially outwards (wheel) and downwards (rail). Serves the paper's section
Simulation Environment."""

import numpy as np
from numpy.polynomial import Polynomial

MM = 1e-3
TAPE_CIRCLE = 0.75  # distance of the tape circle from the track centre (m): half of 1360 mm back to back, plus 70 mm
GAUGE, GAUGE_DEPTH = 1.435, 0.014  # track gauge, and depth below the top of the rails at which it is measured (m)
INCLINATION = np.arctan(1 / 40)  # of the rail towards the track centre (rad)

_TREAD = Polynomial(
    (0, -3.358537058e-2, 1.565681624e-3, -2.810427944e-5, 5.844240864e-8, -1.562379023e-8)
    + (5.309217349e-15, -5.957839843e-12, 2.646656573e-13)
)
_ROOT = Polynomial(
    (-4.320221063e3, -1.038384026e3, -1.065501873e2, -6.051367875, -2.054332446e-1, -4.169739389e-3)
    + (-4.687195829e-5, -2.252755540e-7)
)
_CHAMFER = Polynomial((1.364323640, -0.066666667))
_FLANK = Polynomial((-93.576667419, -2.747477419))


def _arc(centre: tuple[float, float], radius: float, side: int):
    """Height and slope of a circular arc (mm); `side` +1 is the upper half, -1 the lower."""

    def root(s):
        return np.sqrt(np.maximum(radius**2 - (s - centre[0]) ** 2, 1e-12))

    return lambda s: centre[1] + side * root(s), lambda s: -side * (s - centre[0]) / root(s)


# From the field side to the back of the flange: lower limit of the lateral coordinate (mm), height and slope.
_S1002 = (
    (32.15796, _CHAMFER, _CHAMFER.deriv()),
    (-26.0, _TREAD, _TREAD.deriv()),
    (-35.0, _ROOT, _ROOT.deriv()),
    (-38.426669071, *_arc((-26.210665, 16.446), 13.0, -1)),
    (-39.764473993, _FLANK, _FLANK.deriv()),
    (-49.662510381, *_arc((-58.558326413, 8.834924130), 20.0, 1)),
    (-62.764705882, *_arc((-55.0, 16.0), 12.0, 1)),
    (-70.0, *_arc((-49.5, 9.519259302), 20.5, 1)),
)


def s1002(lateral) -> tuple[np.ndarray, np.ndarray]:
    """Wheel profile S1002: radius minus the nominal radius (m), and its derivative by `lateral` (-), each in the shape
    of `lateral`. `lateral` is the coordinate from the tape circle (m), from -0.07 (back of the flange) to 0.06 (field
    side). Source: EN 13715 (UIC 510-2), S1002 with a flange 28 mm high and 32.5 mm thick."""
    s = np.asarray(lateral, dtype=float) / MM
    zones = [s >= limit for limit, _, _ in _S1002]
    height = np.select(zones, [f(s) for _, f, _ in _S1002], np.nan)
    return height * MM, np.select(zones, [df(s) for _, _, df in _S1002], np.nan)


CROWN_RADIUS = 0.3  # of the 60E1 head (m)
# Radius and outer end of the arcs of the 60E1 head (mm); neighbouring arcs have a common tangent.
_HEAD = ((CROWN_RADIUS / MM, 10.5), (80.0, 26.0), (13.0, None))
_SIDE_SLOPE = 20.0


def rail_head(lateral) -> np.ndarray:
    """Depth of the head of an upright 60E1 rail below its crown (m), in the shape of `lateral`. `lateral` is the
    distance from the axis of symmetry (m), up to 0.036 to both sides. Source: EN 13674-1, radii 300, 80 and 13 mm; the
    ends of the arcs are fitted to measured points within 2 micrometres."""
    y = np.abs(np.asarray(lateral, dtype=float)) / MM
    inside, depths = [], []
    centre, z = 0.0, _HEAD[0][0]
    for (radius, end), (following, _) in zip(_HEAD, (*_HEAD[1:], (0.0, None)), strict=True):
        sine = (end - centre) / radius if end else np.sin(np.arctan(_SIDE_SLOPE))
        inside.append(y <= centre + radius * sine)
        depths.append(z - np.sqrt(np.maximum(radius**2 - (y - centre) ** 2, 0)))
        centre, z = centre + (radius - following) * sine, z - (radius - following) * np.sqrt(1 - sine**2)
    return np.select(inside, depths, np.nan) * MM


def inclined_rail() -> tuple[np.ndarray, np.ndarray]:
    """Cross-section of the right rail 60E1, inclined 1:40, with its gauge face at half the gauge: distances from the
    track centre, increasing, and depths below the highest point of the rail (m), each of shape (20001,)."""
    y = np.linspace(-36.0, 36.0, 20_001) * MM
    z = rail_head(y)
    turned = y * np.cos(INCLINATION) + z * np.sin(INCLINATION)
    depth = -y * np.sin(INCLINATION) + z * np.cos(INCLINATION)
    depth -= _HEAD[0][0] * MM * (np.cos(INCLINATION) - 1)
    gauge_side = turned < turned[np.argmin(depth)]
    face = np.interp(GAUGE_DEPTH, depth[gauge_side][::-1], turned[gauge_side][::-1])
    return turned - face + GAUGE / 2, depth
