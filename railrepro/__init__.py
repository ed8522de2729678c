"""Model predictive control of railway running gears with driven independently rotating wheels, replicated."""

__version__ = "0.2.0.dev0"
