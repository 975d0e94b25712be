"""The run's time, of which loads, wall velocities and tractions may be functions."""

from ngsolve import Parameter

time = Parameter(0.0)
"""Time in seconds, to be used in what depends on it; its value is the end of the last step."""
