"""Studies: many runs, executed in parallel, stored, compared and drawn (paper: Multi-Body Simulation Results)."""
