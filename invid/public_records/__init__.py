"""Records of real machines that others published, for the tutorials: whence, and under what licence."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from functools import cached_property
from importlib.resources import files

SOURCE = "https://raw.githubusercontent.com"


@dataclass(frozen=True)
class RecordFile:
    """A file of a set: its name here, its path in its repository, its SHA-256."""

    name: str
    upstream: str
    sha256: str


@dataclass(frozen=True)
class RecordSet:
    """One published set of records, at one commit of the repository that carries it."""

    name: str
    machine: str
    repository: str
    commit: str
    licence: str
    cite: str

    @cached_property
    def files(self) -> tuple[RecordFile, ...]:
        """Return the files that the tutorials read, with the licence where its repository has one."""
        table = files(__name__).joinpath("files.csv").read_text(encoding="utf-8")
        rows = [row for row in csv.DictReader(table.splitlines()) if row["set"] == self.name]
        return tuple(RecordFile(row["file"], row["upstream"], row["sha256"]) for row in rows)

    @property
    def notice(self) -> str:
        """Return what lies beside the files: origin, licence and whom to cite."""
        origin = f"https://github.com/{self.repository}, commit {self.commit}"
        return f"{self.machine}\nFrom: {origin}\nLicence: {self.licence}\nCite: {self.cite}\n"


SETS = (
    RecordSet(
        "flexible_drive",
        "Motor bench with a flexible coupling",
        "WataruOhnishi/FdiTools",
        "760b945947491d93917557a145e8637fa209c7d8",
        "MIT (LICENSE beside the files)",
        "W. Ohnishi and others, FdiTools",
    ),
    RecordSet(
        "emps",
        "Ball screw in closed loop",
        "forgi86/sysid-neural-continuous",
        "956aa7ecd73061b0321c6f6098d74c9e4a7ce67a",
        "none stated by the data's authors (the repository that carries them: Apache-2.0): use and cite, "
        "do not pass on",
        "A. Janot, M. Gautier, M. Brunot: Data Set and Reference Models of EMPS, 2019",
    ),
    RecordSet(
        "silverbox",
        "Electronic oscillator",
        "antonior92/sysid-neuralnet",
        "8da23c9810f738aececa6058a53e40e9a621e5bc",
        '"free data set": use and cite, do not pass on',
        "T. Wigren, J. Schoukens: Three free data sets for development and benchmarking in nonlinear system "
        "identification, ECC 2013",
    ),
    RecordSet(
        "screw_drives",
        "Screw drives on CANopen servos",
        "RViMLab/TRO2021-Dynamic-Modelling",
        "c3b758b4343db54f1020e59961e07c5425b5eea2",
        "MIT (LICENSE beside the files)",
        "A. Mablekos-Alexiou and others, IEEE Transactions on Robotics 37(4), 2021",
    ),
    RecordSet(
        "double_pendulum",
        "Double pendulum, design A.0",
        "dfki-ric-underactuated-lab/double_pendulum",
        "1e8544e67f3da72a51ee52fbbb278e131ce2a43f",
        "BSD-3-Clause (LICENSE beside the files)",
        "DFKI Robotics Innovation Center, Underactuated Lab",
    ),
    RecordSet(
        "kr300",
        "Axis 1 of a large robot, trajectory A",
        "JonasWeigand/Robot_Identification",
        "9e403c07d9dadbb391a9f3921e8d219f714636a8",
        "MIT (LICENSE beside the files)",
        "J. Weigand, Robot_Identification",
    ),
)
