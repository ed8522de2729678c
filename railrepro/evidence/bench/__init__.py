"""Speed of solvers, car and closed loop."""
