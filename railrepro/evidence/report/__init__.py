"""Verdicts on the statements, the report, and what notebooks show of it; serves Multi-Body Simulation Results."""
