"""Controllers and the car for others: C that needs nothing else, and units of FMI 2.0."""
