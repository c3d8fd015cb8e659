"""A law of another package runs like those of this one. The package is the one of the page."""

import numpy as np
import pytest

from dpc_ros.control import ControlLaw, LawSettings, Target, check_law, make_law
from dpc_ros.control.registry import ENTRY_POINT_GROUP as GROUP
from dpc_ros.control.registry import law_names


def test_the_law_of_the_page_pulls_the_mass_to_its_place(spring, small_system):
    system = small_system(3)
    settings = LawSettings(largest_force=4.0, options={'stiffness': 5.0})
    law = make_law(spring, system, settings)
    assert isinstance(law, ControlLaw)
    assert spring in law_names()
    check_law(spring)
    np.testing.assert_array_equal(law.force(np.zeros(3), np.zeros(3)), 0)
    goal = np.array([0.5, 0.2, -0.1])
    law.regulate(Target(latent=goal))
    np.testing.assert_allclose(law.force(goal, np.zeros(3)), 0, atol=1e-12)
    moved = system.full_input_field.T @ (
        system.autoencoder.decode(goal) - system.autoencoder.decode(np.zeros(3))
    )
    np.testing.assert_allclose(law.unbounded_force(np.zeros(3), np.zeros(3)), 5.0 * moved)
    assert np.linalg.norm(law.force(np.full(3, 50.0), np.zeros(3))) <= 4.0 * (1 + 1e-12)


@pytest.mark.parametrize(
    ('code', 'message'),
    [
        ('import nothing_at_all', "'mine': mine_law:Law can not be loaded, No module named"),
        ('Law = 3', "'mine': 'int' object is not callable"),
        ('def Law(system, settings): return 3', "'mine': expected a ControlLaw, got int"),
        ('def Law(system): return 3', "'mine': Law\\(\\) takes 1 positional argument"),
    ],
)
def test_what_is_no_law_is_refused(install_package, small_system, code, message):
    install_package('mine_law', code, {'mine': 'mine_law:Law'}, GROUP)
    with pytest.raises(ValueError, match=message):
        make_law('mine', small_system(3))
