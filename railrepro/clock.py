"""The clock of car and controllers."""

CONTROL_PERIOD = 1e-3
"""Period at which car and controllers are coupled (s). Source: section Simulation Environment of the paper."""
