"""Statements of the paper as functions of results, the runs that they need, and results that they must refuse."""
