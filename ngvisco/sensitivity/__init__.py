"""Derivatives of runs by their parameters: exact sensitivities of the discrete scheme, and fits to data."""
