"""Curves that have exact derivatives, and derivatives by differences, against which the tests hold them."""

from fuzzyarm.envs.scenario.paths import Circle, Lemniscate, Line, Spline

WAYPOINTS = ((0.6, 0.1), (0.5, 0.5), (0.1, 0.6), (-0.3, 0.5))
LOOP = ((0.5, 0.3), (0.6, 0.5), (0.4, 0.7), (0.2, 0.5))
PATHS = {
    "paper circle": Circle(),
    "arc": Circle(center=(0.3, 0.3), radius=0.3, start_angle=0.4, turns=0.3),
    "across the negative x axis": Circle(center=(-0.6, 0.0), radius=0.2),
    "line": Line((0.7, 0.2), (0.2, 0.7)),
    "lemniscate": Lemniscate((0.4, 0.4), 0.2, angle=0.5),
    "spline": Spline(WAYPOINTS),
    "closed spline": Spline(LOOP, closed=True),
}


def central_difference(function, x, h=1e-5):
    """Return (f(x + h) - f(x - h)) / 2h, exact to h² f'''/6."""
    return (function(x + h) - function(x - h)) / (2.0 * h)
