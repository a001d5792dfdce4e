"""The process that tunes: takes its task from its line, writes files into a folder and says how it went."""

from __future__ import annotations

import zipfile

from invid.api import tune
from invid.errors import InvidError
from invid.model.diagnosis_document import load_document
from invid.model.document import dump_json, load_json, save_text
from invid.tuning.forms import write_tuning
from invid_drivers.protocol import Done, Failed, Line
from invid_service.jobs.protocol import TuningTask
from invid_service.precedence import behind_parent
from invid_service.store.blobs import KINDS


def carry_out(task: TuningTask) -> None:
    """Tune and leave the files of the store's kinds in the folder, all of them once more in one archive."""
    source = load_document(task.source)
    tuned = tune(source, cycle=task.cycle_s, notches=task.notches, draws=task.draws)
    written = write_tuning(tuned, task.folder, drive=task.drive, motors=dict(task.motors))
    path = task.folder / KINDS["tuning"][0]
    save_text(path, dump_json({**load_json(path), "simulated": task.simulated}))
    with zipfile.ZipFile(task.folder / KINDS["tuning-files"][0], "w", zipfile.ZIP_DEFLATED) as archive:
        for name in written.files:
            archive.write(task.folder / name, name)


def main() -> None:
    """Carry out the task of the line."""
    behind_parent()
    line = Line.of_process()
    try:
        carry_out(line.read_task())
        line.tell(Done())
    except InvidError as error:
        line.tell(Failed(error))
    line.close()


if __name__ == "__main__":
    main()
