"""A user's URDF against a recording of a machine that MuJoCo simulated from another file."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
from machines.mujoco_cells import Cell, drawn, measured, urdf, users, write, wrong

import invid
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model
from invid.simulators.judge import judge
from invid.simulators.open import open_simulator


def plain(cell: Cell) -> Cell:
    """The cell with no link on another, which the branches of elastic joints in a URDF are not."""
    return replace(cell, carried=(False,) * len(cell.inertia))


def truth(cell: Cell, couplings: float = 0.0, *effects: EffectTerm) -> Model:
    """The cell as a model."""
    coupled = couplings * (np.ones((len(cell.axes),) * 2) - np.eye(len(cell.axes)))
    chains = CoupledChains.build(cell.inertia, cell.springs, cell.dampers, coupled, axes=cell.axes)
    return Model("cell", "refined", chains, ChainStd.unknown(chains), effects=effects)


def term(cause: str, axis: str, element: str | None, **values: float) -> EffectTerm:
    return EffectTerm(cause, axis, {k: Estimate(v, None, None) for k, v in values.items()}, element=element)


def opened(folder: Path, text: str, axes: tuple[str, ...] = ("R1", "R2")) -> Any:
    (folder / "robot.urdf").write_text(text)
    return open_simulator(folder / "robot.urdf", axes)


ELASTIC = plain(drawn(3, kinds=(), motion="multisine", sizes=(2, 2)))
ARM = replace(drawn(3, kinds=(), motion="multisine", sizes=(1, 1)), carried=(False, True))


@pytest.fixture(scope="module", params=[pytest.param("elastic", marks=pytest.mark.campaign), "arm"])
def machine(request: Any, tmp_path_factory: pytest.TempPathFactory) -> tuple[Cell, invid.Recording, Any]:
    folder = tmp_path_factory.mktemp(request.param)
    cell = {"elastic": ELASTIC, "arm": ARM}[request.param]
    write(cell, measured(cell), folder / "rec.h5")
    recording = invid.read_recording(folder / "rec.h5")
    return cell, recording, invid.diagnose(recording, budget=60)


@pytest.mark.parametrize("gear", [pytest.param(1.0, marks=pytest.mark.campaign), -50.0])
def test_a_right_urdf_is_called_right_and_a_wrong_one_is_mended_behind_any_gear(
    machine: Any, gear: float, tmp_path: Path
) -> None:
    cell, recording, diagnosis = machine
    rotor = len(cell.inertia[0]) > 1
    assert judge(recording, diagnosis, opened(tmp_path, urdf(cell, gear=gear, rotor=rotor)))["right"]
    other = wrong(cell, 0.3)
    simulator = opened(tmp_path, urdf(other, gear=gear, rotor=rotor))
    found = judge(recording, diagnosis, simulator, tmp_path / "mended.urdf")
    assert found["held_out"]["after"] < 1.3 < 20.0 < found["held_out"]["before"]
    assert (found["missing"], found["cannot_hold"]) == ([], [])
    told = {p["name"]: p for p in found["parameters"]}["R2 mass 1"]
    assert told["value"] == pytest.approx(cell.inertia[1][0], rel=0.01)
    assert told["simulator"] == pytest.approx(other.inertia[1][0], rel=1e-6)
    text = (tmp_path / "mended.urdf").read_text()
    assert "<!-- my robot -->" in text
    assert 'mesh filename="package://none/q1_1.stl"' in text
    import yourdfpy  # half a second that only this test needs

    again = yourdfpy.URDF.load(str(tmp_path / "mended.urdf"), load_meshes=False, build_scene_graph=False)
    assert set(again.joint_map) == {f"q{i}_{q}" for i in (1, 2) for q in range(1, len(cell.inertia[0]) + 1)}


def test_our_own_export_is_read_back_number_by_number(tmp_path: Path) -> None:
    effects = (
        term("coulomb_friction", "R2", "mass 1", torque=0.3),
        term("viscous_friction", "R1", None, coefficient=0.2),
    )
    model = truth(ELASTIC, 0.0, *effects)
    invid.export(model, "urdf", tmp_path / "robot.urdf")
    claimed = open_simulator(tmp_path / "robot.urdf", ("R1", "R2")).claimed()
    assert claimed is not None
    for kind in ("masses", "springs", "dampers"):
        for ours, theirs in zip(getattr(claimed.chains, kind), getattr(model.chains, kind), strict=True):
            np.testing.assert_allclose(ours, theirs, rtol=1e-9)
    said = {(t.cause, t.axis): next(iter(t.parameters.values())).value for t in claimed.effects}
    assert said == pytest.approx({("coulomb_friction", "R2"): 0.3, ("viscous_friction", "R1"): 0.2})


@pytest.mark.parametrize("kind", ["xml", "urdf"])
def test_the_weight_of_bodies_is_read_as_gravity_and_a_copy_adds_what_it_is_short_of(
    kind: str, tmp_path: Path
) -> None:
    cell = drawn(5, kinds=("weight",), motion="production", sizes=(1,), size=0.5)
    numbers = cell.hidden[0].numbers
    (tmp_path / f"robot.{kind}").write_text(users(cell) if kind == "xml" else urdf(cell))
    simulator = open_simulator(tmp_path / f"robot.{kind}", ("R1",))
    claimed = simulator.claimed()
    assert claimed is not None
    (own,) = (t for t in claimed.effects if t.cause == "gravity")
    assert (own.axis, own.element) == ("R1", "mass 1")
    assert own.value("torque") == pytest.approx(numbers["torque"])
    angle = own.value("angle")

    def with_gravity(factor: float) -> Model:
        found = {"torque": Estimate(factor * numbers["torque"], 0.01 * numbers["torque"], "N·m")}
        effect = EffectTerm("gravity", "R1", {**found, "angle": Estimate(angle, None, "rad")}, "mass 1")
        return truth(cell, 0.0, effect)

    copy, cannot = simulator.corrected(with_gravity(1.0), tmp_path / f"same.{kind}")
    assert cannot == []
    heavier, cannot = simulator.corrected(with_gravity(1.5), tmp_path / f"more.{kind}")
    assert [x.split()[0] for x in cannot] == ([] if kind == "xml" else ["gravity"])
    assert felt(copy, 0.7) == pytest.approx(numbers["torque"] * np.sin(0.7 + angle), rel=1e-4)
    more = 1.5 if kind == "xml" else 1.0
    assert felt(heavier, 0.7) == pytest.approx(more * numbers["torque"] * np.sin(0.7 + angle), rel=1e-4)
    assert heavier.plant.model.chains.masses[0][0] == pytest.approx(cell.inertia[0][0], rel=1e-4)


def felt(simulator: Any, angle: float) -> float:
    """Torque that holds the only joint at an angle, by the engine."""
    data = mujoco.MjData(simulator.plant.compiled)
    data.qpos[0] = angle
    mujoco.mj_forward(simulator.plant.compiled, data)
    return float(data.qfrc_bias[0] - data.qfrc_passive[0] - data.qfrc_actuator[0])


NO_DRIVES = '<robot name="r"><link name="b"/><joint name="j" type="revolute"/></robot>'


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("<robot", "is no XML"),
        ("<mujoco/>", "a URDF has <robot>"),
        (NO_DRIVES, r'the transmissions none; add one a motor.*<joint name="j"/><actuator name="R1">'),
        ('<!DOCTYPE r [<!ENTITY a "b">]><robot/>', "DOCTYPE"),
        ('<robot><xacro:macro name="m"/></robot>', r"xacro robot.urdf > robot\.expanded\.urdf"),
        (("<mechanicalReduction>1.0</mechanicalReduction>", ""), "of R1: has no <mechanicalReduction>"),
        ((">1.0</mechanical", ">fast</mechanical"), "<mechanicalReduction> is 'fast'; give a number"),
        ((">1.0</mechanical", ">0</mechanical"), "give one, not 0"),
        (('"q1_1"/><actuator', '"q9"/><actuator'), 'of R1: joint "q9" is missing'),
        (("</actuator>", '</actuator><invid recorded="load"/>'), '"load"/>; it is "motor" or "joint"'),
        (("<springStiffness>", "<springStiffness>k"), '<gazebo reference="q1_2"><springStiffness> is \'k'),
        (('izz="', 'izz="a'), "robot.urdf: XML Error"),
    ],
)  # fmt: skip
def test_a_urdf_that_leaves_a_drive_open_is_refused_with_what_to_add(
    text: str | tuple[str, str], says: str, tmp_path: Path
) -> None:
    content = text if isinstance(text, str) else urdf(ELASTIC).replace(*text)
    with pytest.raises(invid.InputError, match=says) as raised:
        opened(tmp_path, content)
    assert "robot.urdf" in str(raised.value)
