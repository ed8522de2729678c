"""Export of car and controllers: C source without dependencies, FMUs (FMI 2.0), a live page."""
