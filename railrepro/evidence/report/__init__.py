"""Figures, notation, claims and the report; serves the paper's section Multi-Body Simulation Results."""
