"""The clock that car and controllers share."""

CONTROL_PERIOD = 1e-3
"""Period of the control cycle at which plant and controllers are coupled (s); paper, section Simulation Environment."""
