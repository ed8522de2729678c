"""From CasADi functions to compiled C, with the headers it needs; no section of the paper, its times rest on it."""
