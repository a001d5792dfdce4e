"""Run the application under uvicorn; a signal stops motion before anything else."""

from __future__ import annotations

import asyncio
import socket
from types import FrameType
from typing import Any

import uvicorn
from pydantic import ValidationError

from invid.cli.output import note
from invid.errors import ConfigError, InputError
from invid_service.app import create_app
from invid_service.connection import Connection, allow_many_connections
from invid_service.logs import configure_logging
from invid_service.precedence import before_others
from invid_service.settings import Settings
from invid_service.supervision import stay_alive, tell

_GRACE_S = 5


def settings_from(given: dict[str, Any]) -> Settings:
    """Return settings from the command line over the environment; ConfigError names what is wrong."""
    try:
        return Settings(**given)
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"setting {where}: {first['msg']}; found {first.get('input')!r}") from None


class _Server(uvicorn.Server):
    """Server that stops motion at the signal itself, not when the last connection has ended; tells systemd
    how it is.
    """

    def __init__(self, config: uvicorn.Config, announcement: str) -> None:
        super().__init__(config)
        self._announcement = announcement

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        await super().startup(sockets)
        if not self.should_exit:
            note(self._announcement)  # now that it listens
            tell("READY=1")
            self._alive = asyncio.create_task(stay_alive())

    async def shutdown(self, sockets: list[socket.socket] | None = None) -> None:
        tell("STOPPING=1")
        await super().shutdown(sockets)

    def handle_exit(self, sig: int, frame: FrameType | None) -> None:
        service = self.config.app.state.service  # type: ignore[union-attr]
        try:
            asyncio.get_running_loop().call_soon_threadsafe(service.begin_shutdown)
        except RuntimeError:
            service.shutting_down = True
        super().handle_exit(sig, frame)


def serve_forever(settings: Settings, *, json_logs: bool = False) -> None:
    """Serve until a signal comes."""
    configure_logging(json_lines=json_logs)
    bound = _bind(settings)
    try:
        app = create_app(settings)
        port = bound.getsockname()[1]
        shown = f"[{settings.host}]" if ":" in settings.host else settings.host
        cells = ", ".join(
            f"{c.id} ({'simulated' if c.simulated else c.config.bus.channel})"
            for c in app.state.service.cells.values()
        )
        where = f"invid serve: http://{shown}:{port}/   cells: {cells}   data: {settings.data_dir.resolve()}"
        allow_many_connections()
        before_others()
        config = uvicorn.Config(
            app,
            http=Connection,
            ws="none",
            log_config=None,
            access_log=False,
            timeout_graceful_shutdown=_GRACE_S,
            server_header=False,
            proxy_headers=bool(settings.trusted_proxies),
            forwarded_allow_ips=settings.trusted_proxies or None,
        )
        _Server(config, where).run(sockets=[bound])
    finally:
        bound.close()


def _bind(settings: Settings) -> socket.socket:
    family = socket.AF_INET6 if ":" in settings.host else socket.AF_INET
    bound = socket.socket(family, socket.SOCK_STREAM)
    bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
    try:
        bound.bind((settings.host.strip("[]"), settings.port))
    except OSError as error:
        bound.close()
        raise InputError(
            f"cannot listen on {settings.host}:{settings.port}: {error.strerror or error}; "
            f"is another service running there? --port chooses another"
        ) from None
    return bound
