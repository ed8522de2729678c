"""Tuning of the controllers: particle swarm, cost, stability margin, and the tuned sets. Serves the paper's section
Multi-Body Simulation Results (PSO over Q, R, q, H, T)."""
