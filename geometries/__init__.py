"""Domains with named walls, meshed by Netgen; sizes are in the user's unit of length."""

from ngvisco.geometries.boxes import bar, block_with_hole, box, channel, structured_box
from ngvisco.geometries.files import load
from ngvisco.geometries.meshing import refine_corners, refine_walls, split_corner_cells
from ngvisco.geometries.round import annulus, cylinder, disc, half_disc, sphere, spherical_shell

__all__ = [
    "annulus",
    "bar",
    "block_with_hole",
    "box",
    "channel",
    "cylinder",
    "disc",
    "half_disc",
    "load",
    "refine_corners",
    "refine_walls",
    "sphere",
    "spherical_shell",
    "split_corner_cells",
    "structured_box",
]
