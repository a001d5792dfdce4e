"""A right simulator is called right whatever stands around the axis; what is not read is not called lacking.

Two masses of 0.7 and 2 kg·m² on a spring of 1000 N·m/rad, integrated by the matrix exponential; the
simulators are written by hand.
"""

import re
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pythonfmu.builder import FmuBuilder
from two_masses import free_multisine

import invid
from invid.errors import InputError
from invid.numerics.arrays import frozen_float
from invid.recording.model import Experiment, Kind, Recording, Role
from invid.simulators.judge import judge
from invid.simulators.open import open_simulator

STEP, PERIOD = 1e-3, 2048
COUNT = 1.2e-5
BY_NIGHT = pytest.mark.campaign


def driven(periods: int, gear: float, role: Role) -> Experiment:
    position, torque = free_multisine(periods, COUNT)
    return Experiment(
        key="000" if role is Role.IDENTIFY else "001", kind=Kind.MULTISINE, role=role, excited_axis=0,
        hold_gain=frozen_float(np.zeros(1)), period_samples=PERIOD,
        frequencies_hz=frozen_float(np.arange(1, 80) / (PERIOD * STEP)), sample_rate_hz=1 / STEP,
        time=frozen_float(np.arange(torque.size) * STEP),
        position=frozen_float(gear * position[:, None]), torque=frozen_float(torque[:, None] / gear),
        torque_demand=None, status=None,
    )  # fmt: skip


def recorded(gear: float = 1.0) -> tuple[Recording, Any]:
    recording = Recording(
        robot="bench", axes=("A1",), position_unit="rad", torque_unit="N·m", created="2026-11-27T00:00:00Z",
        experiments=(driven(6, gear, Role.IDENTIFY), driven(4, gear, Role.VALIDATE)),
        masses_per_axis=(2,), rated_torque=frozen_float([50 / gear]),
    )  # fmt: skip
    return recording, invid.diagnose(recording)


@pytest.fixture(scope="module")
def bench() -> tuple[Recording, Any]:
    return recorded()


def xml(motor: str = "", beside: str = "", top: str = "", act: str = "", inertia: float = 0.7) -> str:
    return f"""<mujoco model="bench"><compiler angle="radian"/>
<option gravity="0 0 0" timestep="0.0005" integrator="implicitfast"/>{top}<worldbody>
<body name="motor"><joint name="A1" axis="0 0 1" damping="0.5" {motor}/>
<inertial pos="0 0 0" mass="1" diaginertia="{inertia} {inertia} {inertia}"/>{beside.partition("|")[2]}</body>
<body name="load"><joint name="load" axis="0 0 1" damping="0.5"/>
<inertial pos="0 0 0" mass="1" diaginertia="2 2 2"/></body>{beside.partition("|")[0]}</worldbody>
<tendon><fixed stiffness="1000" damping="0.6"><joint joint="A1" coef="1"/>
<joint joint="load" coef="-1"/></fixed></tendon>
<actuator><motor name="A1" joint="A1" {act}/></actuator></mujoco>"""


INERTIAL = '<inertial pos="0 0 0" mass="0.001" diaginertia="1e-7 1e-7 1e-7"/>'
DOOR = '<body name="door" pos="2 0 0"><joint name="door" axis="0 0 1"/><geom size="0.3" mass="5"/></body>'
RIGHT = {
    "range": (xml(motor='range="0.2 2.8" limited="true"'), "range 0.2"),
    "actuatorfrcrange": (xml(motor='actuatorfrcrange="-5 5"'), "limits its torque to 5"),
    "ctrlrange": (xml(act='ctrlrange="-1 1" ctrllimited="true"'), ""),
    "door": (xml(beside=DOOR), "door: not recorded"),
    "free box on the floor": (
        xml(
            beside='<geom type="plane" size="9 9 1"/><body name="box" pos="3 0 1"><freejoint/>'
            '<geom size="0.1"/></body>'
        ),
        "not recorded",
    ),
    "finger on a spring": (
        xml(
            beside='|<body pos="0.05 0 0"><joint name="finger" axis="0 1 0" stiffness="5" damping="0.1"/>'
            f"{INERTIAL}</body>"
        ),
        "finger: not recorded",
    ),
    "slide on a spring": (
        xml(
            beside='|<body pos="0.05 0 0"><joint name="jaw" type="slide" axis="1 0 0" stiffness="10" '
            f'damping="1"/>{INERTIAL}</body>'
        ),
        "jaw: not recorded",
    ),
    "mesh": (
        xml(
            top='<asset><mesh name="m" file="gone.stl"/><texture name="t" type="2d" file="gone.png"/>'
            '<material name="c" texture="t"/></asset>',
            beside='|<geom type="mesh" mesh="m" material="c"/>',
        ),
        "files are missing",
    ),
}  # fmt: skip
QUICK = ("mesh",)


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, marks=() if c in QUICK else pytest.mark.campaign) for c in RIGHT],
)
def test_what_surrounds_the_axis_is_locked_or_released_and_said(
    bench: Any, tmp_path: Path, case: str
) -> None:
    text, said = RIGHT[case]
    (tmp_path / "a.xml").write_text(text)
    found = judge(*bench, open_simulator(tmp_path / "a.xml", ("A1",)))
    assert found["right"], found["sentences"]
    assert said in " ".join(found["warnings"])


@pytest.mark.parametrize(
    "beside",
    [
        DOOR,
        pytest.param("|" + DOOR.replace("door", "lid").replace('mass="5"', 'mass="1e-6"'), marks=BY_NIGHT),
    ],
)
def test_a_wrong_number_is_told_with_other_joints_beside_and_the_copy_keeps_them(
    bench: Any, tmp_path: Path, beside: str
) -> None:
    (tmp_path / "a.xml").write_text(xml(beside=beside, inertia=0.5))
    found = judge(*bench, open_simulator(tmp_path / "a.xml", ("A1",)), tmp_path / "b.xml")
    assert [(p["name"], round(p["simulator"], 2), round(p["value"], 2)) for p in found["parameters"]] == [
        ("A1 mass 1", 0.5, 0.7)
    ]
    assert found["missing"] == []
    assert found["held_out"]["after"] < 1.2
    assert re.search(r'<joint name="(door|lid)"', (tmp_path / "b.xml").read_text())


@pytest.mark.campaign
@pytest.mark.parametrize("gear", [50.0, 0.02])
def test_a_recording_of_the_other_side_of_a_gear_is_named_as_that(tmp_path: Path, gear: float) -> None:
    (tmp_path / "a.xml").write_text(xml())
    found = judge(*recorded(gear), open_simulator(tmp_path / "a.xml", ("A1",)), tmp_path / "b.xml")
    told = re.search(r"of a gear of ([\d.]+), the file", " ".join(found["sentences"]))
    assert told is not None
    assert float(told[1]) == pytest.approx(50.0, rel=1e-3)
    assert found["corrected"] is None
    assert found["parameters"] == []


def urdf(i1: float, extra: str, izz: str = 'ixx="2" iyy="2" izz="2"') -> str:
    def link(name: str, moments: str) -> str:
        return (
            f'<link name="{name}"><inertial><mass value="1"/><inertia {moments} ixy="0" ixz="0" iyz="0"/>'
            "</inertial></link>"
        )

    def even(value: float) -> str:
        return f'ixx="{value}" iyy="{value}" izz="{value}"'

    def joint(name: str, parent: str, child: str, more: str) -> str:
        return (
            f'<joint name="{name}" type="revolute"><parent link="{parent}"/><child link="{child}"/>'
            f'<axis xyz="0 0 1"/><limit lower="-3" upper="3" effort="1" velocity="5"/>{more}</joint>'
        )

    twin = "".join(
        link(f"l{k}", even(float(inertia)))
        + joint(f"t{k}", parent, f"l{k}", f'<mimic joint="j1" multiplier="{ratio}"/>')
        for k, (parent, inertia, ratio) in enumerate(e.split() for e in extra.split(";") if e)
    )  # fmt: skip
    return (
        f'<robot name="b"><link name="base"/>{link("m", even(i1))}{link("load", izz)}{twin}'
        + joint("j1", "base", "m", '<dynamics damping="0.5"/>')
        + joint("spring", "m", "load", '<dynamics damping="0.6"/>')
        + '<gazebo reference="spring"><springStiffness>1000</springStiffness></gazebo>'
        '<transmission name="t1"><joint name="j1"/><actuator name="A1">'
        "<mechanicalReduction>1</mechanicalReduction></actuator>"
        "</transmission></robot>"
    )


@pytest.mark.parametrize(
    ("own", "twins"),
    [pytest.param(0.3, "base 0.1 -2", marks=BY_NIGHT), (0.4, "m 0.1 -2;base 0.1 1")],
    ids=["twice as far, backwards", "carried, and beside"],
)
def test_joints_that_mimic_the_motors_count_with_it(
    bench: Any, tmp_path: Path, own: float, twins: str
) -> None:
    # Carried by the motor's link, a twin of ratio −2 turns at −1 in space: 0.1 · (1 − 2)² = 0.1.
    own = 0.5 if twins.startswith("m ") else own
    (tmp_path / "a.urdf").write_text(urdf(own, twins))
    claimed = open_simulator(tmp_path / "a.urdf", ("A1",)).claimed()
    assert claimed is not None
    assert claimed.chains.masses[0] == pytest.approx([0.7, 2.0], rel=1e-6)
    found = judge(*bench, open_simulator(tmp_path / "a.urdf", ("A1",)), tmp_path / "b.urdf")
    assert found["parameters"] == []
    again = open_simulator(tmp_path / "b.urdf", ("A1",)).claimed()
    assert again is not None
    assert again.chains.masses[0] == pytest.approx([0.7, 2.0], rel=3e-3)


PLANT = """
import math
from pythonfmu import Fmi2Causality, Fmi2Slave, Real

class {name}(Fmi2Slave):
    def __init__(self, **kwargs):
        super().__init__(**kwargs)
        self.u, self.y, self.s = 0.0, 0.0, [0.0] * 4
        self.register_variable(Real("u", causality=Fmi2Causality.input))
        self.register_variable(Real("y", causality=Fmi2Causality.output))

    def do_step(self, now, h):
        {fault}
        n = max(1, math.ceil(h / 2.5e-4))
        d = h / n
        def f(s):
            k = 1000 * (s[0] - s[1]) + 0.6 * (s[2] - s[3])
            return [s[2], s[3], (self.u - k - 0.5 * s[2]) / 0.7, (k - 0.5 * s[3]) / 2.0]
        for _ in range(n):
            s = self.s
            a = f(s)
            b = f([x + d / 2 * y for x, y in zip(s, a)])
            c = f([x + d / 2 * y for x, y in zip(s, b)])
            e = f([x + d * y for x, y in zip(s, c)])
            self.s = [x + d / 6 * (p + 2 * q + 2 * r + t) for x, p, q, r, t in zip(s, a, b, c, e)]
        self.y = self.s[0] * {scale}
        return True
"""


def fmu(
    folder: Path, name: str, scale: float = 1.0, fault: str = "", unit: str = "", without: str = ""
) -> Path:
    (folder / f"{name}.py").write_text(PLANT.format(name=name, scale=scale, fault=fault or "pass"))
    made = Path(FmuBuilder.build_FMU(folder / f"{name}.py", dest=folder))
    out = folder / f"{name}_.fmu"
    with zipfile.ZipFile(made) as old, zipfile.ZipFile(out, "w") as new:
        for member in old.namelist():
            data = old.read(member)
            if member == "modelDescription.xml" and unit:
                text = re.sub(
                    r'(name="y".*?<Real)', rf'\1 unit="{unit.split()[0]}"', data.decode(), flags=re.DOTALL
                )
                defined = unit.split()[1:]
                if defined:
                    base = f'<UnitDefinitions><Unit name="{unit.split()[0]}">'
                    base += f'<BaseUnit rad="1" factor="{defined[0]}"/>'
                    text = text.replace("<LogCategories>", base + "</Unit></UnitDefinitions><LogCategories>")
                data = text.encode()
            if not (without and without in member):
                new.writestr(member, data)
    return out


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("elsewhere", {"without": "linux"}, "win64"),
        ("licence", {"fault": "return False"}, "the FMU fails: .*DoStep"),
        ("furlong", {"unit": "furlong"}, "'furlong' is no unit of position"),
    ],
)
def test_what_fails_inside_an_fmu_is_bad_input_and_named(
    bench: Any, tmp_path: Path, name: str, options: dict[str, str], said: str
) -> None:
    with pytest.raises(InputError, match=said):
        judge(*bench, open_simulator(fmu(tmp_path, name, **options), ("A1",)))
