"""Model predictive control of railway running gears with driven independently rotating wheels, replicated."""

__version__ = "0.1.0"
