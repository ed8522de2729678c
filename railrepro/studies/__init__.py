"""Studies: many runs side by side, executed in parallel, stored, compared and drawn. Serves the paper's section
Multi-Body Simulation Results."""
