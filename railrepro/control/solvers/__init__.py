"""Solvers of the optimal control problem; serves the paper's section Nonlinear Model Predictive Control."""
