"""From CasADi functions to compiled C. Serves no section of the paper, but the times of its solvers."""
