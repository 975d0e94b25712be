"""Ranks: what of a distributed mesh a rank does not know alone."""
