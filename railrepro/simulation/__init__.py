"""Scenarios, the closed loop and its figures of merit; serves the paper's section Simulation Environment."""
