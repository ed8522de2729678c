"""The multibody car in place of SIMPACK; serves the paper's section Simulation Environment."""
