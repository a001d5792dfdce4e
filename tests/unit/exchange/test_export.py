"""Exported models, loaded by the tools they are for: the frequency responses are those of the matrices."""

import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import scipy.io
import scipy.linalg
import scipy.signal

import invid
from invid.cli.app import run
from invid.model.chains import CoupledChains
from invid.model.document import ChainStd, EffectTerm, Estimate, Model, model_from_json, parameter_vector

control = pytest.importorskip("control")
mujoco = pytest.importorskip("mujoco")
fmpy = pytest.importorskip("fmpy")
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu

# Light damping (0.2 %), so that a wrong number shows as a peak in the wrong place.
SIZES = {
    "one mass": (1,),
    "one axis": (4,),
    "unequal": (3, 1, 2, 5),
    "single masses": (1, 1, 1),
    "many": (2, 3, 3, 3, 2, 1),
}


def machine(name: str, *, coupled: bool = True, linear: bool = False, seed: int = 1) -> Model:
    """A random plant of the given shape with couplings of both signs; knows nothing of the exporters."""
    sizes = SIZES[name]
    rng = np.random.default_rng([seed, len(sizes), sum(sizes)])
    masses = [rng.uniform(0.3, 3.0, n) for n in sizes]
    springs = [rng.uniform(500.0, 4000.0, n - 1) for n in sizes]
    dampers = [0.002 * 2 * np.sqrt(k * m[1:]) for k, m in zip(springs, masses, strict=True)]
    count = len(sizes)
    couplings = np.zeros((count, count))
    if coupled:
        # Strong, and no row dominated by its diagonal: a full random positive definite block.
        factor = rng.normal(size=(count, count + 1))
        block = factor @ factor.T
        scale = np.sqrt(np.array([m[-1] for m in masses]) / np.diag(block))
        couplings = block * np.outer(scale, scale)
        np.fill_diagonal(couplings, 0.0)
        couplings = 0.5 * (couplings + couplings.T)
    chains = CoupledChains.build(masses, springs, dampers, couplings)
    names, values = parameter_vector(chains)
    return Model(
        robot="robot of a test",
        method="refined",
        chains=chains,
        std=ChainStd.unknown(chains),
        linear=linear,
        covariance=np.diag((1e-3 * np.abs(values)) ** 2),
        parameter_names=names,
    )


def truth(model: Model, damping: dict[int, float] | None = None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """M, D, K of the model's chains, with viscous friction at the coordinates named."""
    mass = np.array(model.chains.mass_matrix)
    damp = np.array(model.chains.damping_matrix)
    for at, value in (damping or {}).items():
        damp[at, at] += value
    return mass, damp, np.array(model.chains.stiffness_matrix)


def lines(mass: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    """Angular frequencies from a hundredth of the lowest mode to 1.5 times the highest, modes among them."""
    modes = np.sqrt(np.maximum(scipy.linalg.eigh(stiffness, mass, eigvals_only=True), 0.0))
    elastic = modes[modes > 1e-3]
    if elastic.size == 0:
        return np.geomspace(1.0, 1000.0, 50)
    spread = np.geomspace(0.01 * elastic[0], 1.5 * elastic[-1], 300)
    return np.sort(np.concatenate([spread, elastic * 1.0003, elastic * 0.999]))


def response(matrices: tuple[np.ndarray, ...], motors: np.ndarray, omega: np.ndarray) -> np.ndarray:
    mass, damp, stiff = matrices
    out = []
    for w in omega:
        out.append(np.linalg.inv(stiff + 1j * w * damp - w**2 * mass)[np.ix_(motors, motors)])
    return np.array(out)


def assert_same(found: np.ndarray, wanted: np.ndarray) -> None:
    """0.1 % of each element, or of what its axes do at that line where the element is near a zero."""
    own = np.abs(np.diagonal(wanted, axis1=1, axis2=2))
    size = np.maximum(np.abs(wanted), 1e-3 * np.sqrt(own[:, :, None] * own[:, None, :]))
    assert np.max(np.abs(found - wanted) / size) < 1e-3


CASES = [
    ("one mass", True, False),
    ("one axis", False, False),
    ("unequal", True, False),
    ("unequal", False, False),
    ("single masses", True, True),
    ("many", True, True),
]
"""Pairwise: every size, with and without couplings, of both motions."""


@pytest.mark.parametrize(("name", "coupled", "linear"), CASES)
def test_python_control_answers_as_the_model_does(
    name: str, coupled: bool, linear: bool, tmp_path: Path
) -> None:
    model = machine(name, coupled=coupled, linear=linear)
    invid.export(model, "statespace", tmp_path / "m.mat")
    mat = scipy.io.loadmat(tmp_path / "m.mat", simplify_cells=True)
    count = model.chains.branches
    a, b, c, d = (np.asarray(mat[k], dtype=float) for k in "ABCD")
    system = control.ss(a, b.reshape(a.shape[0], count), c.reshape(count, -1), d.reshape(count, count))
    mass, damp, stiff = truth(model)
    omega = lines(mass, stiff)
    found = np.array([system(1j * w) for w in omega]).reshape(omega.size, count, count)
    assert_same(found, response((mass, damp, stiff), model.chains.motor_dofs, omega))
    assert list(np.atleast_1d(mat["inputs"])) == [f"{x}.torque" for x in model.axes]
    assert list(np.atleast_1d(mat["outputs"])) == [f"{x}.position" for x in model.axes]
    assert len(np.atleast_1d(mat["states"])) == a.shape[0]
    assert mat["input_unit"] == ("N" if linear else "N·m")
    assert list(np.atleast_1d(mat["parameters"])) == list(model.parameter_names)
    np.testing.assert_allclose(
        np.reshape(mat["covariance"], model.covariance.shape), model.covariance, rtol=1e-12
    )


def mujoco_matrices(m: object) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """M, D, K from MuJoCo's forward dynamics, and B: the generalised force of each control."""
    data = mujoco.MjData(m)
    n, count = m.nv, m.nu

    def force(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        mujoco.mj_resetData(m, data)
        data.qpos[:], data.qvel[:], data.ctrl[:] = q, v, u
        mujoco.mj_forward(m, data)
        return np.array(data.qfrc_passive + data.qfrc_actuator)

    zero, none, eye = np.zeros(n), np.zeros(count), np.eye(n)
    stiff = -np.array([force(e, zero, none) for e in eye]).T
    damp = -np.array([force(zero, e, none) for e in eye]).T
    drive = np.array([force(zero, zero, e) for e in np.eye(count)]).T.reshape(n, count)
    mujoco.mj_resetData(m, data)
    mujoco.mj_forward(m, data)
    # The accelerations themselves, not a mass matrix that the solver might not use.
    accelerations = []
    for e in eye:
        data.qfrc_applied[:] = e
        mujoco.mj_forward(m, data)
        accelerations.append(np.array(data.qacc))
    return np.linalg.inv(np.array(accelerations).T), damp, stiff, drive


@pytest.mark.parametrize(("name", "coupled", "linear"), CASES)
def test_mujoco_answers_as_the_model_does(name: str, coupled: bool, linear: bool, tmp_path: Path) -> None:
    model = machine(name, coupled=coupled, linear=linear)
    invid.export(model, "mjcf", tmp_path / "m.xml")
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "m.xml"))
    names = [f"{a}.mass.{q + 1}" for a, n in zip(model.axes, SIZES[name], strict=True) for q in range(n)]
    assert [m.joint(i).name for i in range(m.njnt)] == names
    assert [m.actuator(i).name for i in range(m.nu)] == list(model.axes)
    kind = mujoco.mjtJoint.mjJNT_SLIDE if linear else mujoco.mjtJoint.mjJNT_HINGE
    assert all(int(t) == int(kind) for t in m.jnt_type)
    mass, damp, stiff, drive = mujoco_matrices(m)
    motors = model.chains.motor_dofs
    np.testing.assert_allclose(drive, np.eye(m.nv)[:, motors], atol=1e-12)
    wanted = truth(model)
    omega = lines(wanted[0], wanted[2])
    assert_same(response((mass, damp, stiff), motors, omega), response(wanted, motors, omega))


def urdf_matrices(path: Path) -> tuple[tuple[np.ndarray, np.ndarray, np.ndarray], list[str]]:
    """M, D, K in absolute positions of the links, from what yourdfpy reads and Gazebo's springs."""
    yourdfpy = pytest.importorskip("yourdfpy")
    robot = yourdfpy.URDF.load(str(path), build_scene_graph=False, load_meshes=False).robot
    springs = {
        g.get("reference"): float(g.findtext("springStiffness"))
        for g in ElementTree.parse(path).getroot().iter("gazebo")
    }
    links = {x.name: x for x in robot.links}
    names = [j.child for j in robot.joints]
    n = len(names)
    absolute = np.zeros((n, n))  # position of each link per position of each joint
    for k, joint in enumerate(robot.joints):
        if joint.parent != "base":
            absolute[k] = absolute[names.index(joint.parent)]
        absolute[k, k] = 1.0
    relative = np.linalg.inv(absolute)
    inertias = [
        links[j.child].inertial.mass if j.type == "prismatic" else links[j.child].inertial.inertia[2, 2]
        for j in robot.joints
    ]
    damp = np.diag([float(j.dynamics.damping or 0.0) for j in robot.joints])
    stiff = np.diag([springs.get(j.name, 0.0) for j in robot.joints])
    return (np.diag(inertias), relative.T @ damp @ relative, relative.T @ stiff @ relative), names


@pytest.mark.parametrize(("name", "linear"), [(n, k % 2 == 1) for k, n in enumerate(SIZES)])
def test_a_urdf_without_couplings_answers_as_the_model_does(name: str, linear: bool, tmp_path: Path) -> None:
    model = machine(name, coupled=False, linear=linear)
    written = invid.export(model, "urdf", tmp_path / "m.urdf")
    assert not any("couplings" in x or "frequencies" in x for x in written.losses)
    found, names = urdf_matrices(tmp_path / "m.urdf")
    motors = np.array([names.index(f"{a}.mass.1") for a in model.axes])
    wanted = truth(model)
    omega = lines(wanted[0], wanted[2])
    assert_same(response(found, motors, omega), response(wanted, model.chains.motor_dofs, omega))
    # Another reader of the same file: its joints count from the link before.
    m = mujoco.MjModel.from_xml_path(str(tmp_path / "m.urdf"))
    mass = mujoco_matrices(m)[0]
    absolute = scipy.linalg.block_diag(*(np.tril(np.ones((n, n))) for n in SIZES[name]))
    np.testing.assert_allclose(mass, absolute.T @ wanted[0] @ absolute, rtol=1e-6, atol=1e-9)


def pulse_answer(
    path: Path, inputs: str, outputs: list[str], step: float, count: int, **start: float
) -> np.ndarray:
    """(count, outputs) positions after a unit torque that acts for one communication step."""
    times = np.array([0.0, 0.5 * step, 0.5 * step, count * step])
    pulse = np.array(
        list(zip(times, [1.0, 1.0, 0.0, 0.0], strict=True)), dtype=[("time", float), (inputs, float)]
    )
    found = fmpy.simulate_fmu(
        str(path),
        stop_time=count * step,
        output_interval=step,
        input=pulse,
        output=outputs,
        start_values=start,
        use_event_mode=False,
        set_stop_time=False,
    )
    return np.array([found[o] for o in outputs]).T


@pytest.mark.parametrize(("name", "linear"), [("unequal", False), ("one mass", False), ("one axis", True)])
def test_fmpy_answers_as_the_model_does(name: str, linear: bool, tmp_path: Path) -> None:
    model = machine(name, linear=linear)
    invid.export(model, "fmu", tmp_path / "m.fmu")
    assert validate_fmu(str(tmp_path / "m.fmu")) == []
    mass, damp, stiff = truth(model)
    n, motors = mass.shape[0], model.chains.motor_dofs
    omega = lines(mass, stiff)
    step, count = 1.0 / (1.5 * omega[-1]), 600
    a = np.block(
        [[np.zeros((n, n)), np.eye(n)], [-np.linalg.solve(mass, stiff), -np.linalg.solve(mass, damp)]]
    )
    b = np.vstack([np.zeros((n, len(motors))), np.linalg.solve(mass, np.eye(n)[:, motors])])
    system = (a, b, np.eye(2 * n)[motors], np.zeros((len(motors),) * 2))
    _, wanted = scipy.signal.dimpulse((*scipy.signal.cont2discrete(system, step)[:4], step), n=count + 1)
    outputs = [f"{x}.position" for x in model.axes]
    for i, axis in enumerate(model.axes):
        found = pulse_answer(tmp_path / "m.fmu", f"{axis}.torque", outputs, step, count)
        # Frequency responses on a line beside the axis, where free axes have one too.
        s = 5.0 / (count * step) + 1j * omega
        to_frequency = np.exp(-s[:, None] * step * np.arange(count + 1))
        g, h = to_frequency @ found, to_frequency @ wanted[i]
        assert np.max(np.abs(g - h) / np.abs(h).max(axis=1, keepdims=True)) < 1e-3


def effect(
    cause: str, axis: str = "A1", element: str | None = None, other: str | None = None, **sizes: float
):
    return EffectTerm(cause, axis, {k: Estimate(v, 0.1 * v) for k, v in sizes.items()}, element, other)


@pytest.mark.parametrize("to", ["statespace", "mjcf", "urdf", "fmu"])
def test_every_effect_that_is_not_in_the_file_is_named(to: str, tmp_path: Path) -> None:
    model = machine("one axis").extended(
        effect("coulomb_friction", "A1", "mass 2", torque=0.4),
        effect("backlash", "A1", "spring 1", gap=1e-3),
        effect("torque_delay", "A1", delay=7e-4),
        effect("from_a_plug_in", "A1", size=3.0),
    )
    written = invid.export(model, to, tmp_path / "f")
    for cause in ("coulomb_friction", "backlash", "torque_delay", "from_a_plug_in"):
        assert sum(cause in x for x in written.losses) >= 1, cause
    beside = json.loads((tmp_path / "f.json").read_text())
    assert beside["losses"] == list(written.losses)
    assert model_from_json(beside["model"]).effects[1].cause == "backlash"
    if to == "statespace":
        assert scipy.io.loadmat(tmp_path / "f")["input_delay"].ravel() == pytest.approx(7e-4)
    if to == "mjcf":
        m = mujoco.MjModel.from_xml_path(str(tmp_path / "f"))
        assert m.dof_frictionloss.tolist() == [0, 0.4, 0, 0]
        assert m.opt.disableflags & int(mujoco.mjtDisableBit.mjDSBL_FRICTIONLOSS)


def test_the_command_says_losses_on_stderr_and_one_document_on_stdout(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine("one axis").extended(effect("coulomb_friction", torque=0.4)).save(tmp_path / "m.json")
    where = [str(tmp_path / "m.json"), "--to", "statespace", "-o", str(tmp_path / "m.mat")]
    assert run(["export", *where, "--json"]) == 0
    out, err = capsys.readouterr()
    assert "coulomb_friction" in err
    assert json.loads(out)["losses"] == ["coulomb_friction on A1 (torque 0.4) is left out"]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--to", "simulink", "-o", "x"), "there are statespace, mjcf, urdf, fmu"),
        (("--to", "mjcf", "-o", "."), "is a folder"),
        (("--to", "urdf", "-o", "/proc/nothing/x"), "cannot be written"),
    ],
)
def test_bad_requests_end_with_one_message(
    arguments: tuple[str, ...], says: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    machine("one axis").save(tmp_path / "m.json")
    assert run(["export", str(tmp_path / "m.json"), *arguments]) == 2
    assert says in capsys.readouterr().err
