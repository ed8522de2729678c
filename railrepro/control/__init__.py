"""Adhesion law, NDI, MPC and their integration; serves the paper's sections from NMPC to Integration Approach."""
