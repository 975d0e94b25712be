"""Domains with named walls, meshed by Netgen; sizes in the user's length unit."""

from ngvisco.geometries.boxes import box

__all__ = ["box"]
