"""Export of controllers and car: C without dependencies, and FMUs (FMI 2.0)."""
