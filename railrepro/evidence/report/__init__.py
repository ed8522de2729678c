"""Figures of the notebooks, verdicts and the report; serves the paper's section Multi-Body Simulation Results."""
