"""Service of the set-up page: a small web server on loopback, which ends when the set-up is finished."""

from __future__ import annotations

from collections.abc import Callable
from queue import Empty

from agent.errors import Aborted
from agent.service.daemon.main_loop import queued_signals
from agent.service.http.endpoint import HttpServer
from agent.service.page.setup_app import create_setup_app
from agent.service.setup.session import SetupSession
from agent.settings.service import ServiceSettings
from drivers.errors import LinkLost

LOOK_EVERY_S = 0.2
SETUP_PORT = 8518
"""Port of the set-up page; the service of a machine that is set up already has the one before."""


def serve_setup(session: SetupSession, port: int, ready: Callable[[str], None]) -> None:
    """Serve the set-up page on loopback until a person finishes it, and call `ready` with its address.

    Port 0 means any free port. Raises Aborted at SIGTERM or SIGINT if nothing has been written, and ConfigurationError
    if the port cannot be bound.
    """
    server = HttpServer(ServiceSettings(host="127.0.0.1", port=port))
    with queued_signals() as signals:
        server.serve(create_setup_app(session))
        try:
            ready(f"{server.url}/#token={session.token}")
            while not session.finished.wait(LOOK_EVERY_S):
                if not server.alive:
                    raise LinkLost("the web server of the set-up has ended")
                try:
                    signals.get_nowait()
                except Empty:
                    continue
                break
        finally:
            server.shut_down()
            session.close()
    if session.written is None:
        raise Aborted("the set-up was ended before anything was written")
