"""A search that starts with the friction that the identification found: what is there is named, no more."""

from dataclasses import replace

import numpy as np

from hidden.causes import CATALOGUE
from hidden.measurement import Active, record
from hidden.plants import Plant, random_plant
from hidden.setup import draw_setup
from invid.diagnosis.diagnose import diagnose
from invid.identification.identify import identify
from invid.model.document import EffectTerm, Estimate
from invid.recording.model import Recording

DRY, WET = (0.03, 0.012), (0.15, 0.04)


def _recording(seed: int, *, rubs: bool) -> Recording:
    """Two axes of two masses each; dry and viscous friction at both motors, or none."""
    rng = np.random.default_rng(seed)
    plant: Plant = random_plant(rng, ("A1", "A2"), (2, 2), linear=False)
    setup = draw_setup(
        rng, plant, noise=0.003, bits=20, moves=False, periods=3, drive="smooth", from_rest=False
    )
    active = []
    for axis in range(2) if rubs else ():
        for name, key, size in (
            ("coulomb_friction", "torque", DRY[axis]),
            ("viscous_friction", "coefficient", WET[axis]),
        ):
            active.append(Active(CATALOGUE[name], axis, 1, -1, {key: size}))
    recording, _, _ = record(rng, setup, tuple(active), (2, 2))
    return recording


def test_friction_on_every_axis_is_named_with_its_size_from_where_the_identification_found_it() -> None:
    recording = _recording(11, rubs=True)
    result = diagnose(recording, model=identify(recording))
    found = {(f.effect.cause, f.effect.axis): f for f in result.findings}
    truth = {("coulomb_friction", a): t for a, t in zip(recording.axes, DRY, strict=True)}
    truth |= {("viscous_friction", a): t for a, t in zip(recording.axes, WET, strict=True)}
    assert set(found) == set(truth)
    for key, size in truth.items():
        (estimate,) = found[key].effect.parameters.values()
        assert estimate.std is not None
        assert abs(estimate.value - size) < max(4.0 * estimate.std, 0.03 * size), (key, size, estimate)
    shares = {key: f.fraction for key, f in found.items()}
    assert sum(shares.values()) > 0.98
    # Each cause has its own share of what they explain together, and none is rounded where nothing rounds it.
    assert shares["coulomb_friction", "A1"] > 1.2 * shares["viscous_friction", "A1"]
    assert not any("rounding" in f.effect.parameters for f in result.findings)


def test_friction_that_a_model_claims_of_a_machine_without_any_is_not_named() -> None:
    recording = _recording(12, rubs=False)
    model = identify(recording)
    claimed = tuple(
        EffectTerm("coulomb_friction", axis, {"torque": Estimate(0.05, 0.002, "N·m")}, element="mass 1")
        for axis in recording.axes
    )
    assert not diagnose(recording, model=replace(model, effects=claimed)).findings
