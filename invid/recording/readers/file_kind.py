"""What kind a file is: one class a kind, which recognises its files and reads them or says how they are."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from dataclasses import dataclass
from pathlib import Path

from invid.errors import InputError
from invid.recording.import_map import Source
from invid.recording.tables import Table

HEAD = 8192
"""Bytes of a file that a kind is recognised by."""


@dataclass(frozen=True)
class FileStart:
    """What tells the kind of a file: its name and its first bytes."""

    path: Path
    head: bytes

    @classmethod
    def of(cls, path: Path) -> FileStart:
        """The start of a file; InputError where it is empty or cannot be read."""
        try:
            with path.open("rb") as raw:
                head = raw.read(HEAD)
        except OSError as error:
            raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
        if not head:
            raise InputError(f"{path}: the file is empty")
        return cls(path, head)

    @property
    def text(self) -> str:
        """The first lines; nothing of a binary file."""
        return "" if b"\0" in self.head else self.head.decode("utf-8-sig", "replace")


class FileKind(ABC):
    """A kind of file. Its evidence: first bytes before a line of the head before the name's ending."""

    name: str
    """As a map's ``source.kind`` names it, or as a refusal does."""
    endings: tuple[str, ...] = ()
    starts: tuple[bytes, ...] = ()
    header: re.Pattern[str] | None = None
    """Found in the first lines of its text files."""

    def evidence(self, start: FileStart) -> int:
        """6 for first bytes, 4 for a line of the head, one more where the ending agrees; 0: none."""
        ending = start.path.suffix.lower() in self.endings
        if self.starts and start.head.startswith(self.starts):
            return 6 + ending
        if self.header is not None and self.header.search(start.text):
            return 4 + ending
        return int(ending)

    @abstractmethod
    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """The columns of a file; ``beside`` is the map's folder.

        Raises
        ------
        InputError
            A file that is damaged, or of a kind that is not read: with the way to one that is.
        """


class RefusedKind(FileKind):
    """Files that are recognised and not read: by ``what`` they are, with the ``way`` out."""

    def __init__(
        self, name: str, way: str, *, starts: tuple[bytes, ...] = (), header: str = "",
        endings: tuple[str, ...] = (),
    ) -> None:  # fmt: skip
        self.name, self.way, self.starts, self.endings = name, way, starts, endings
        self.header = re.compile(header) if header else None

    def __call__(self, path: Path, source: Source, *, beside: Path | None = None) -> Table:
        """Refuse the file by name."""
        raise InputError(f"{path}: is {self.name}, which is not read: {self.way}")


def is_document(path: Path) -> bool:
    """Whether a file is about the records, or a program, and none of them: by its name."""
    return bool(_DOCUMENT.search(path.name))


_DOCUMENT = re.compile(
    # README.txt, LICENSE, notes.md, plot_results.m, robot.urdf, config.yaml, photo.jpg, .DS_Store
    r"^(readme|licen[cs]e|changelog|notes?|citation|authors|makefile)(\.\w+)?$|^\.|"
    r"\.(md|rst|pdf|docx?|pptx?|html?|tex|bib|png|jpe?g|svg|gif|mp4|py|m|mlx|ipynb|sh|bat|ps1|c|cpp|h|"
    r"ya?ml|json|toml|ini|cfg|xml|urdf|xacro|dbc|eds|dcf|pyc|license)$",
    re.IGNORECASE,
)
