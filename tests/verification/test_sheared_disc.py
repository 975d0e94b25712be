"""References of the soft disc in shear: an ellipse with uniform fields, and a mesh that follows the disc."""

import numpy as np
import pytest

from tests.verification.sheared_disc import Fitted, ellipse, images


@pytest.mark.parametrize("capillary", [0.1, 0.2, 0.4])
def test_steady_ellipse_without_bounds_has_the_closed_form(capillary: float) -> None:
    D, angle = ellipse(capillary, np.array([20.0]))[0]
    assert pytest.approx(capillary * (1 - D**2) / (1 + D**2), rel=1e-4) == D
    assert np.sin(2 * np.radians(angle)) == pytest.approx(D / capillary, rel=2e-3)


def test_the_effect_of_periodic_images_falls_with_the_square_of_the_cell_size() -> None:
    near, far = images(4.0), images(8.0)
    assert near[1][0, 0] / far[1][0, 0] == pytest.approx(4.0, rel=0.2)


def test_periodic_images_in_a_cell_of_12_radii_enlarge_the_steady_deformation() -> None:
    """The published closed form is for one disc alone; the kept references have .1900 in place of .1866."""
    alone, among = (ellipse(0.2, np.array([20.0]), *of)[0][0] for of in ((), (images(12.0),)))
    assert 1.012 < among / alone < 1.024


def test_fitted_mesh_follows_the_ellipse_in_a_creeping_flow() -> None:
    disc = Fitted(0.2, 500.0, 0.005, 12.0, maxh=0.5, dt=0.05)
    while disc.t < 0.5 - 1e-9:
        disc.advance()
    D, angle, area = disc.shape()
    expected, direction = ellipse(0.2, np.array([0.5]), images(12.0, maxh=0.5))[0]
    assert pytest.approx(expected, rel=0.03) == D
    assert angle == pytest.approx(direction, abs=0.5)
    assert area == pytest.approx(1.0, abs=2e-3)
