"""Tuning of the controllers (the paper's section Multi-Body Simulation Results: PSO over Q, R, q, H, T)."""
