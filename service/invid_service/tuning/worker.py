"""The process that tunes: reads its order on stdin, writes files into a folder, says on stdout how it
went."""

from __future__ import annotations

import json
import sys
import zipfile
from pathlib import Path

from pydantic import BaseModel, Field

from invid.api import tune
from invid.errors import InputError, InvidError
from invid.model.diagnosis_document import load_document
from invid.model.document import dump_json, load_json, save_text
from invid.tuning.forms import write_tuning
from invid.tuning.motor_scale import MotorScale
from invid_service.precedence import behind_parent
from invid_service.store.blobs import KINDS


class Order(BaseModel):
    """What to tune and where to put it."""

    folder: Path
    source: Path
    simulated: bool
    cycle_s: float
    notches: int
    draws: int
    drive: str | None
    motors: dict[str, MotorScale] = Field(default_factory=dict)


def carry_out(order: Order) -> None:
    """Tune and leave the files of the store's kinds in the folder, all of them once more in one archive."""
    tuned = tune(load_document(order.source), cycle=order.cycle_s, notches=order.notches, draws=order.draws)
    written = write_tuning(tuned, order.folder, drive=order.drive, motors=order.motors)
    path = order.folder / KINDS["tuning"][0]
    save_text(path, dump_json({**load_json(path), "simulated": order.simulated}))
    with zipfile.ZipFile(order.folder / KINDS["tuning-files"][0], "w", zipfile.ZIP_DEFLATED) as archive:
        for name in written.files:
            archive.write(order.folder / name, name)


def main() -> int:
    """Exit status 0, or 1 with a JSON object that says why not."""
    behind_parent()
    try:
        carry_out(Order.model_validate_json(sys.stdin.read()))
    except InvidError as error:
        print(json.dumps({"error": str(error), "input": isinstance(error, InputError)}))
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
