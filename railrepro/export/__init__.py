"""Controllers and the car for others: C that needs nothing else, and FMUs (FMI 2.0)."""
