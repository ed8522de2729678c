"""Wheel-rail contact: profiles, normal forces, creep forces; serves the paper's section Simulation Environment."""
