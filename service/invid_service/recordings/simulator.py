"""Take a simulator that was uploaded beside a recording: data alone.

Nothing of it runs the sender's code or reads another file of this machine. XML is read without entities,
checked and written anew, so that the engine reads what was checked; the engine itself runs in the run's own
process, with its memory and time.
"""

from __future__ import annotations

import json
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from invid.errors import InputError
from invid.model.diagnosis_document import document_from_json
from invid.simulators.plain_xml import parsed
from invid_service.problems import Problem

LARGEST = 4 * 1024**2
"""Bytes of one simulator; the largest robots described without their meshes take a tenth."""
DEEPEST = 100
_RUN_OR_READ = ("include", "plugin", "extension")


def checked_simulator(data: bytes) -> tuple[str, bytes]:
    """Return the ending of its format and the text for the engine; a problem says what is not taken."""
    if len(data) > LARGEST:
        raise Problem("too-large", f"simulator: more than {LARGEST} bytes arrived", limit=LARGEST)
    if data.startswith(b"PK"):
        raise _refused(
            "this is an archive; an FMU holds native code, which the service does not run for a sender: run "
            "'invid diagnose REC.h5 --against robot.fmu' on a computer of your own"
        )
    try:
        if data.lstrip()[:1] == b"{":
            document_from_json(json.loads(data), source="simulator")
            return ".json", data
        root = parsed(data, "simulator")
    except (ValueError, RecursionError) as error:
        raise _refused(f"cannot be read: {error}") from None
    except InputError as error:
        raise _refused(str(error).removeprefix("simulator: ")) from None
    _bounded(root)
    if root.tag == "robot":  # its meshes are never read
        return ".urdf", ElementTree.tostring(root, encoding="unicode").encode()
    if root.tag != "mujoco":
        raise _refused(
            f"its root is <{str(root.tag)[:64]}>; a MuJoCo XML (<mujoco>), a URDF (<robot>) or an invid "
            "model (JSON) is taken"
        )
    _alone(root)
    return ".xml", ElementTree.tostring(root, encoding="unicode").encode()


def _refused(detail: str) -> Problem:
    return Problem("invalid-simulator", f"simulator: {detail}")


def _bounded(root: Element) -> None:
    """Refuse a tree so deep that whoever walks it runs out of stack."""
    level, depth = [root], 0
    while level:
        depth += 1
        if depth > DEEPEST:
            raise _refused(f"elements stand more than {DEEPEST} deep in one another")
        level = [child for element in level for child in element]


def _alone(root: Element) -> None:
    """Refuse what would read another file or load code; comments are left out."""
    for element in root.iter():
        for child in [c for c in element if not isinstance(c.tag, str)]:
            element.remove(child)
        if element.tag in _RUN_OR_READ:
            raise _refused(
                f"<{element.tag}> is not taken: one file that needs no other and no plugin; MuJoCo's "
                "mj_saveLastXML writes included files into one"
            )
        for name, value in element.attrib.items():
            if name.startswith("file"):
                raise _refused(
                    f'<{element.tag} {name}="{value[:64]}">: no other file is read; leave meshes, textures '
                    "and height fields out and give their bodies an <inertial>"
                )
