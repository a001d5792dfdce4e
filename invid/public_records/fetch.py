"""Fetch a set of records over HTTP; what is there and whole is not fetched again."""

from __future__ import annotations

from pathlib import Path
from urllib.parse import quote

import pooch
from requests import RequestException

from invid.errors import InputError
from invid.model.document import save_text
from invid.public_records import RecordFile, RecordSet

NOTICE = "SOURCE.txt"


def cache_folder() -> Path:
    """Return the folder of this user for fetched records."""
    return Path(pooch.os_cache("invid")) / "records"


def fetch(records: RecordSet, folder: Path, source: str) -> Path:
    """Bring the files of a set below ``folder``, each checked by its hash; return the set's own folder.

    Raises
    ------
    InputError
        The source cannot be reached, has no such file (any more), or another file.
    """
    pooch.get_logger().setLevel("WARNING")
    own = folder / records.name
    for file in records.files:
        path = f"{records.repository}/{records.commit}/{quote(file.upstream)}"
        _fetch(file, f"{source.rstrip('/')}/{path}", own)
    save_text(own / NOTICE, records.notice)
    return own


def _fetch(file: RecordFile, url: str, own: Path) -> None:
    target = own / file.name
    try:
        pooch.retrieve(url, f"sha256:{file.sha256}", fname=target.name, path=target.parent)
    except RequestException as error:
        if error.response is not None:
            status = error.response.status_code
            raise InputError(f"{url}: answers {status}", way_out="name a mirror with --source") from None
        raise InputError(
            f"{url}: cannot be reached ({type(error).__name__})",
            way_out="without a network fetch elsewhere with `invid fetch-data --to records` and copy that "
            "folder here, or name a mirror with --source; demo and quickstart need no record",
        ) from None
    except ValueError:  # pooch: the hash
        raise InputError(
            f"{url}: is not the file that was published (its SHA-256 is not {file.sha256[:12]}…); nothing of "
            "it was kept"
        ) from None
