"""The clock that car and controllers share."""

EXCHANGE_PERIOD = 1e-3
"""Period of the exchange between plant and controllers (s); paper, section Simulation Environment."""
