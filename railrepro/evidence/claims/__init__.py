"""Statements of the paper as predicates over runs, the runs that they need, and those that must fail."""
