"""Time schemes as sequences of Rothe steps: tableaux, the integrator, its error estimate."""
