"""Ctrl-C in the middle of a line on stderr stops the measurement in order, and is no error of the program."""

import io
import signal

import pytest

from invid.cli.output import note
from invid_drivers.cli.measure import stop_on_signals


class Interrupted(io.StringIO):
    """A stderr in whose first line a signal comes, and which must not be entered twice, as Python's own."""

    def __init__(self) -> None:
        super().__init__()
        self.inside, self.raised = False, False

    def write(self, text: str) -> int:
        if self.inside:
            raise RuntimeError("reentrant call")
        self.inside = True
        if not self.raised:
            self.raised = True
            signal.raise_signal(signal.SIGINT)
        self.inside = False
        return super().write(text)


def test_a_signal_within_a_line_on_stderr_asks_for_the_stop(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    with stop_on_signals() as stop:
        line = Interrupted()
        monkeypatch.setattr("sys.stderr", line)
        note("  10 %  trying the signs")
        assert stop.is_set()
        with pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGINT)
    monkeypatch.undo()
    assert "trying the signs" in line.getvalue()
    assert "once more to stop at once" in capfd.readouterr().err
