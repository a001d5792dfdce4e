"""Save what a killed runner left in its working folder."""

from __future__ import annotations

import logging
from pathlib import Path

from invid.errors import RecordingError
from invid.recording.spool import SUFFIX, has_rows, is_spool
from invid.recording.writer import put_in_place
from invid_service.store.blobs import KINDS

log = logging.getLogger(__name__)


def complete_recording(folder: Path) -> None:
    """Make a recording of the rows that a killed runner measured.

    OSError where the disk does not take it: the rows then stay in the folder.
    """
    target = folder / KINDS["recording"][0]
    rows = target.with_name(target.name + SUFFIX)
    if target.exists() or not is_spool(rows) or not has_rows(rows):
        return
    try:
        put_in_place(rows, target)
    except RecordingError as error:
        log.error("run %s: what it measured cannot be read: %s", folder.name, error)
