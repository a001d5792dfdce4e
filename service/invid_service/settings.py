"""Settings of the service: environment variables ``INVID_…`` or arguments of ``invid serve``."""

from __future__ import annotations

import ipaddress
from pathlib import Path

from pydantic import Field
from pydantic_settings import BaseSettings, SettingsConfigDict

from invid_drivers.relay import STOP_S

_LAST_WORDS_S = 3.0
"""For the runner to close its recording after its cycle process has ended."""
MEBIBYTE = 1024 * 1024
_BUDGET_SHARE = 5 / 6
"""Of ``analysis_timeout_s``; reading, the report and the step in which the time runs out take the rest."""


class Settings(BaseSettings):
    """Everything ``create_app`` needs; nothing is read from anywhere else."""

    model_config = SettingsConfigDict(env_prefix="INVID_", extra="forbid", env_nested_delimiter="__")

    host: str = "127.0.0.1"
    port: int = Field(default=8000, ge=0, le=65535)
    data_dir: Path = Path(".invid")
    cells: list[Path] = []
    """Configs, one a cell; empty: the simulated case study."""
    database_url: str | None = None
    """SQLAlchemy URL; default SQLite in ``data_dir``."""
    key_file: Path | None = None
    """Hashed keys; needed for every bind beyond loopback. With it everyone is asked for a key."""
    root_path: str = Field(default="", pattern=r"^(/[A-Za-z0-9._~-]+)*$")
    """Path under which a reverse proxy shows the service, as ``/invid``."""
    trusted_proxies: list[str] = []
    """Addresses or networks of reverse proxies whose ``X-Forwarded-For`` and ``-Proto`` are believed."""
    max_upload_bytes: int = Field(default=512 * MEBIBYTE, gt=0)
    max_unpacked_bytes: int = Field(default=1024 * MEBIBYTE, gt=0)
    """An uploaded recording may unpack to this: eight axes at 1 kHz for an hour are 720 MB."""
    max_body_bytes: int = Field(default=MEBIBYTE, gt=0)
    """Largest body of every other request."""
    upload_stall_s: float = Field(default=30.0, gt=0)
    """An upload that sends nothing for so long is given up."""
    min_free_bytes: int = Field(default=500 * MEBIBYTE, ge=0)
    """No run starts with less room than this on the disk of ``data_dir``."""
    worker_memory_bytes: int = Field(default=16 * 1024 * MEBIBYTE, gt=0)
    """Address space of one runner process; a bomb dies there and takes nobody along."""
    retention_days: float = Field(default=90.0, gt=0)
    """Files of runs older than this go, unless their model is in the history; rows stay."""
    keep_alive_s: float = Field(default=15.0, gt=0)
    arm_timeout_s: float = Field(default=900.0, gt=0)
    """A run that nobody arms for so long is cancelled."""
    check_timeout_s: float = Field(default=120.0, gt=0)
    analysis_timeout_s: float = Field(default=1800.0, gt=0)
    stop_grace_s: float = Field(default=STOP_S + _LAST_WORDS_S, gt=0)
    """Time the runner has to stop its drives before its process is killed (the drives then miss the
    master's heartbeat and stop by themselves): longer than the way out may take, or no hardware is served."""
    motion_silence_s: float = Field(default=120.0, gt=0)
    """A motion of which nothing is heard for so long is stopped: the longest wait in one, for a person to
    support a load, takes half a minute."""
    parallel_uploads: int = Field(default=1, ge=1)
    unchanged_percent: float = Field(default=20.0, gt=0)
    """A change that could be larger than this without being seen is "cannot tell", not "unchanged"."""

    @property
    def loopback(self) -> bool:
        """True where only this machine can reach the service."""
        return is_loopback(self.host)

    @property
    def analysis_budget_s(self) -> float:
        """Return the seconds that an analysis may spend, so that its best answer comes before it is taken for
        hung.
        """
        return self.analysis_timeout_s * _BUDGET_SHARE

    @property
    def database(self) -> str:
        """Return the SQLAlchemy URL in use."""
        return self.database_url or f"sqlite:///{self.data_dir / 'store.sqlite'}"


def is_loopback(host: str) -> bool:
    """True for a name or address that cannot be reached from outside."""
    name = host.strip("[]").lower()
    if name == "localhost":
        return True
    try:
        return ipaddress.ip_address(name).is_loopback
    except ValueError:
        return False
