"""Run one job in a process of its own, ``python -m invid_service.jobs.worker``.

When its line ends, whoever started it is gone: motion is stopped and the process ends.
"""

from __future__ import annotations

import contextlib
import os
import resource
import sys
import threading
import time
import traceback
from pathlib import Path
from typing import Any

from invid.disk import is_full, not_written
from invid.errors import DiskFullError, InvidError, SafetyStop
from invid.wording.sentence import sentence
from invid_drivers.protocol import Done
from invid_service.jobs.folder import LastWords, hold
from invid_service.jobs.protocol import EndedEarly, ErrorInfo, Job, RunnerLine, Stopped, plain, without_folder
from invid_service.jobs.stops import Run, stopped_by
from invid_service.precedence import as_everyone
from invid_service.words import ERRORS, SEE_MANUAL, error_of

STOPPED = ErrorInfo(**error_of("stopped"))


def error_info(error: BaseException) -> ErrorInfo:
    """Return what the service is told of an error: a stable code, the sentence, a way out."""
    if isinstance(error, OSError) and not isinstance(error, InvidError) and is_full(error):
        error = not_written(Path(error.filename or "a file of the run"), error)
    if isinstance(error, MemoryError):
        return ErrorInfo(**error_of("out-of-memory"))
    if not isinstance(error, InvidError):
        own = error_of("internal-error")
        return ErrorInfo(code=own["code"], text=f"{type(error).__name__}: {error}", fix=own["fix"])
    codes = [_code_of(kind) for kind in type(error).__mro__]
    what, fix = next((ERRORS[code] for code in codes if code in ERRORS), ("", SEE_MANUAL))
    text = error.reason if isinstance(error, DiskFullError) else str(error)
    return ErrorInfo(code=codes[0], text=text, what="" if "{" in what else sentence(what), fix=sentence(fix))


def _code_of(kind: type) -> str:
    name = "".join("-" + c.lower() if c.isupper() else c for c in kind.__name__)
    return name.lstrip("-").removesuffix("-error")


def run(line: RunnerLine) -> int:
    """Run one job; return the exit status."""
    job: Job = line.read_task()
    resource.setrlimit(resource.RLIMIT_AS, (job.memory_bytes, job.memory_bytes))
    line.listen(line.hear)
    held = contextlib.ExitStack()
    threading.Thread(target=_end_with_parent, args=(line, job.stop_grace_s), daemon=True).start()
    try:
        held.enter_context(hold(job.folder))
        seen = _measure(job, line) if job.kind == "measure" else None
        summary = _analyse(job, line, seen)
    except Stopped:
        line.tell(EndedEarly(type="stopped", error=STOPPED))
        return 4
    except SafetyStop as error:
        told = STOPPED if line.stop.is_set() else error_info(error)
        LastWords(end=str(error)).write(job.folder)
        line.tell(EndedEarly(type="stopped", error=told, stopped=_stopped_by(error, job)))
        return 4
    except BaseException as error:
        if not isinstance(error, InvidError):
            traceback.print_exc()
        told = error_info(error)
        stopped = _stopped_by(error, job) if isinstance(error, InvidError) else None
        # Where the file lies in the service's own folders is nobody's business.
        text = without_folder(told.text, job.folder)
        told = told.model_copy(update={"text": text})
        LastWords(end=text).write(job.folder)
        line.tell(EndedEarly(type="failed", error=told, stopped=stopped))
        return getattr(error, "exit_code", 70)
    finally:
        held.close()
    line.tell(Done(plain(summary)))
    return 0


def _measure(job: Job, line: RunnerLine) -> dict[str, Any]:
    # Seconds of imports: below the service's precedence, with the end of a job already heard.
    from invid_service.jobs.measurement import measure  # noqa: PLC0415

    return measure(job, line)


def _analyse(job: Job, line: RunnerLine, seen: dict[str, Any] | None) -> dict[str, Any]:
    # Nothing of it is loaded before the axes are at rest.
    from invid_service.jobs.analysis import analyse  # noqa: PLC0415

    return analyse(job, line, seen)


def _stopped_by(error: InvidError, job: Job) -> dict[str, Any] | None:
    linear = bool((job.config or {}).get("motion") == "linear")
    return stopped_by(error, Run(job.mode, job.amplitude, linear, None))


def _end_with_parent(line: RunnerLine, grace_s: float) -> None:
    """Stop the drives and end when the parent has gone: nobody else could stop this process."""
    line.orphaned.wait()
    time.sleep(grace_s)
    os._exit(4)


def main() -> None:
    """Run the job of the line."""
    as_everyone()  # the cycle process takes its own precedence
    line = RunnerLine.of_process()
    status = run(line)
    line.close(5.0)
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    main()
