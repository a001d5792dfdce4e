"""The process that tunes: takes its order from its line, writes files into a folder and says how it went."""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import replace

from invid import arguments
from invid.api import tune
from invid.config import CellConfig
from invid.errors import InvidError
from invid.model.diagnosis_document import load_document
from invid.model.document import dump_json, load_json, save_text
from invid.tuning.axis_loop import AxisLoop
from invid.tuning.forms import write_tuning
from invid.wording.statement import Statement
from invid_drivers.protocol import Done, Failed, line_of_process
from invid_drivers.values.present import known_loops, present_values
from invid_service.precedence import behind_parent
from invid_service.store.blobs import KINDS
from invid_service.tuning.order import Order


def carry_out(order: Order) -> None:
    """Tune and leave the files of the store's kinds in the folder, all of them once more in one archive."""
    source = load_document(order.source)
    before, why = _present(order, arguments.a_model(source).axes)
    tuned = tune(source, before=before, cycle=order.cycle_s, notches=order.notches, draws=order.draws)
    tuned = replace(tuned, statements=(*tuned.statements, *why))
    written = write_tuning(tuned, order.folder, drive=order.drive, motors=dict(order.motors))
    path = order.folder / KINDS["tuning"][0]
    save_text(path, dump_json({**load_json(path), "simulated": order.simulated}))
    with zipfile.ZipFile(order.folder / KINDS["tuning-files"][0], "w", zipfile.ZIP_DEFLATED) as archive:
        for name in written.files:
            archive.write(order.folder / name, name)


def _present(order: Order, axes: Sequence[str]) -> tuple[dict[str, AxisLoop] | None, tuple[Statement, ...]]:
    """What the drives hold now, and why it is not known."""
    if order.config is None:
        return None, ()
    try:
        found = known_loops(present_values(CellConfig.model_validate(order.config), order.motors))
        return {name: loop for name, loop in found.items() if name in axes}, ()
    except InvidError as error:
        return None, (Statement("tune.present_unknown", {"why": str(error.reason or error)}),)


def main() -> None:
    """Carry out the order of the line."""
    behind_parent()
    line = line_of_process()
    try:
        carry_out(line.read_task())
        line.tell(Done())
    except InvidError as error:
        line.tell(Failed(error))
    line.close()


if __name__ == "__main__":
    main()
