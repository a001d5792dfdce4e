"""Effects at one place move what the others feel."""

from types import SimpleNamespace

import numpy as np

from invid.effects.catalogue.viscous_friction import ViscousFriction
from invid.effects.registry import BY_CAUSE
from invid.likelihood.placed_effect import impedances
from invid.model.parameters import ChainStructure
from invid.model.place import Pattern, Place

OMEGA = 2 * np.pi * np.linspace(0.5, 12.0, 30)


def test_two_dampers_feel_each_other_and_the_force_that_a_law_puts_on_the_load() -> None:
    masses, (near, far), force = np.array([1.0, 0.6, 0.4]), (900.0, 300.0), 0.2 + 0.5j
    springs = np.array([[near, -near, 0], [-near, near + far, -far], [0, -far, far]])
    plain = springs - OMEGA[:, None, None] ** 2 * np.diag(masses) + 0j
    damped = plain + 1j * OMEGA[:, None, None] * np.diag([0.0, 0.7, 0.3])

    inner = np.zeros_like(plain)
    inner[:, 1:, 1:] = np.linalg.inv(plain[:, 1:, 1:])
    motion = -inner @ plain[:, :, :1]
    motion[:, 0] = 1.0
    load: Pattern = ((2, 1.0),)
    view = SimpleNamespace(
        omega=OMEGA,
        motion=motion,
        structure=ChainStructure((3,), ("A",)),
        record=SimpleNamespace(transient=False),
        unfiltered=motion[:, :, 0],
        cached=lambda key, make: make(),
        condensed_force=lambda pattern: sum(s * motion[:, at] for at, s in pattern),
        inner_receptance=lambda pattern: sum(s * inner[:, :, at] for at, s in pattern),
    )
    back = -view.inner_receptance(load) * force
    effect = BY_CAUSE["viscous_friction"]
    assert isinstance(effect, ViscousFriction)
    places = ((Place("mass", 0, 2), np.array([0.7])), (Place("mass", 0, 3), np.array([0.3])))
    torque, moved = impedances(view, [(effect, p, x) for p, x in places], back)  # type: ignore[arg-type]

    # The same by the whole plant at once: inner masses under the motor's unit motion and the force.
    asked = np.stack([-damped[:, 1, 0], -damped[:, 2, 0] - force], axis=-1)
    q = np.linalg.solve(damped[:, 1:, 1:], asked[..., None])[..., 0]
    np.testing.assert_allclose((motion[:, :, 0] + back + moved)[:, 1:], q, rtol=1e-9)
    needed = damped[:, 0, 0] + np.einsum("fi,fi->f", damped[:, 0, 1:], q)
    alone = (plain[:, :1] @ motion)[:, 0, 0]
    np.testing.assert_allclose(
        alone + view.condensed_force(load)[:, 0] * force + torque[:, 0], needed, rtol=1e-9
    )
