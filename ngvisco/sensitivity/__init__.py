"""Derivatives of runs by parameters: exact sensitivities of the discrete scheme, and fits to data."""
