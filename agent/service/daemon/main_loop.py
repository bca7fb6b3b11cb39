"""Main loop of the service process, which handles signals, systemd's watchdog and systemd's status text."""

from __future__ import annotations

import signal
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType
from typing import TYPE_CHECKING

import structlog

from agent.errors import Busy
from agent.service.control import Status
from agent.service.daemon.sd_notify import Notifier
from agent.service.owner.health import Health
from agent.service.owner.owner import Owner
from agent.settings.load import load_settings
from agent.settings.schema import Settings
from drivers.clock import RealClock
from drivers.errors import LinkLost, VolcalError

if TYPE_CHECKING:
    from agent.service.daemon.endpoints import Endpoint

log = structlog.get_logger()

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
POLL_PERIOD_S = 1.0
FEEDS_PER_PERIOD = 3.0
"""sd_watchdog_enabled(3) recommends at least two notifications per period."""
US_PER_S = 1e6
_RELOAD_WAITS = "settings are reloaded after the run in progress"
_SECTIONS_AT_START = ("notifications", "gateway", "opcua")
_SERVICE_AT_START = (
    *("host", "port", "host_names", "certificate_file", "key_file", "token_file"),
    *("hang_timeout_s", "computation_timeout_minutes"),
)
"""Settings that the service reads only when it starts."""


@contextmanager
def queued_signals() -> Iterator[SimpleQueue[int]]:
    """Yield a queue that receives the signals sent to the process during the `with` block. These signals do not end the
    process."""
    queue: SimpleQueue[int] = SimpleQueue()

    def enqueue(number: int, _: FrameType | None) -> None:
        queue.put(number)

    former = {number: signal.signal(number, enqueue) for number in SIGNALS}
    try:
        yield queue
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


@dataclass
class MainLoop:
    """Main loop of the service. It ends on SIGTERM or SIGINT."""

    owner: Owner
    health: Health
    notifier: Notifier
    signals: SimpleQueue[int]
    config: Path
    endpoints: Sequence[Endpoint] = ()
    _reload_waits: bool = False
    _last_text: str = ""
    _hung: bool = False

    def __post_init__(self) -> None:
        self._started_with = self.owner.settings

    def run(self) -> None:
        """Report readiness to systemd. Then feed systemd's watchdog, report the status, and reload the settings on
        SIGHUP.

        On SIGTERM or SIGINT hold the run, withdraw the probe, close the owner of the machine and return. If an endpoint
        has ended by itself, do the same and raise LinkLost: clients of that endpoint could no longer abort a run, and
        systemd starts the service again.
        """
        self.owner.reconcile_if_reached()
        self.notifier.send(READY=1, STATUS=self._text())
        period_s = POLL_PERIOD_S
        if self.notifier.watchdog_s is not None:
            period_s = min(period_s, self.notifier.watchdog_s / FEEDS_PER_PERIOD)
        while (number := self._signal(period_s)) not in (signal.SIGTERM, signal.SIGINT):
            if number == signal.SIGHUP or (self._reload_waits and not self.owner.busy):
                self._reload()
            self._feed_watchdog()
            self._require_endpoints()
        self._stop(signal.Signals(number).name if number is not None else "")

    def _require_endpoints(self) -> None:
        ended = [endpoint.name for endpoint in self.endpoints if not endpoint.alive]
        if ended:
            names = ", ".join(ended)
            log.error("an endpoint has ended by itself; the service stops", endpoints=names)
            self._stop(f"the end of the endpoint {names}")
            raise LinkLost(f"the endpoint {names} has ended by itself", hint="its cause is in the log; start again")

    def _signal(self, within_s: float) -> int | None:
        try:
            return self.signals.get(timeout=within_s)
        except Empty:
            return None

    def _feed_watchdog(self) -> None:
        """Notify systemd's watchdog unless the engine hangs.

        If the notifications cease, systemd ends this process. By then the machine's own watchdog has long stopped the
        machine.
        """
        if self.health.alive(self.owner.status().state):
            self._hung = False
            self.notifier.send(WATCHDOG=1)
        elif not self._hung:
            self._hung = True
            log.error("the engine hangs", silent_s=round(self.health.silent_s(), 1))
        self._report_status()

    def _report_status(self) -> None:
        text = self._text()
        if text != self._last_text:
            self._last_text = text
            self.notifier.send(STATUS=text)

    def _text(self) -> str:
        return status_text(self.owner.status(), hung=self._hung)

    def _reload(self) -> None:
        """Read the settings file again for the next runs. If it is invalid, report that and keep the old settings. Name
        the changed settings that need a restart of the service.

        While a run is in progress the file is not even opened; it is read after the end of the run.
        """
        self.notifier.send(RELOADING=1, MONOTONIC_USEC=int(US_PER_S * RealClock().now()))
        self._reload_waits = self.owner.busy
        self.notifier.send(READY=1, STATUS=self._reloaded())

    def _reloaded(self) -> str:
        """Reload the settings and return the result as text for `systemctl status`."""
        if self._reload_waits:
            log.info(_RELOAD_WAITS)
            return _RELOAD_WAITS
        try:
            settings = load_settings(self.config)
            self.owner.reload(settings)
        except Busy:  # a run has begun since the owner was asked
            self._reload_waits = True
            log.info(_RELOAD_WAITS)
            return _RELOAD_WAITS
        except VolcalError as error:
            log.error("settings not reloaded; the previous ones stay in use", reason=str(error))
            return f"settings not reloaded: {error}".replace("\n", " ")
        except Exception as defect:  # a defect in a reader must not end the service and the run with it
            log.exception("settings not reloaded; the previous ones stay in use")
            return f"settings not reloaded: defect in the service ({type(defect).__name__})"
        if unapplied := keys_for_restart(self._started_with, settings):
            log.warning("settings reloaded in part; the others need a restart", need_restart=", ".join(unapplied))
            return f"settings reloaded, except those that need a restart: {', '.join(unapplied)}"
        log.info("settings reloaded")
        return self._text()

    def _stop(self, name: str) -> None:
        within_s = self.owner.settings.service.stop_timeout_s
        log.info("stopping", asked_by=name, within_s=within_s)
        self.notifier.send(
            STOPPING=1, STATUS="stopping: withdrawing the probe", EXTEND_TIMEOUT_USEC=int(US_PER_S * within_s)
        )
        if not self.owner.close(within_s):
            log.error("the run did not end in time; the process ends anyway", within_s=within_s)


def keys_for_restart(started_with: Settings, settings: Settings) -> tuple[str, ...]:
    """Return the keys that differ from the settings with which the service was started, and that it reads only then.

    The service reads all others when it uses them.
    """
    sections = [name for name in _SECTIONS_AT_START if getattr(started_with, name) != getattr(settings, name)]
    service = [
        name for name in _SERVICE_AT_START if getattr(started_with.service, name) != getattr(settings.service, name)
    ]
    return (*sections, *(f"service.{name}" for name in service))


def status_text(status: Status, *, hung: bool = False) -> str:
    """Return the status of the service as one line for `systemctl status`. `hung` is True if the thread of the run
    hangs."""
    parts = [f"{status.machine}: {status.doing}"]
    if status.minutes_left is not None:
        parts.append(f"{100.0 * status.fraction:.0f} %, {status.minutes_left:.0f} min left")
    elif status.simulated_steps:
        parts.append(f"{status.simulated_steps} steps simulated")
    if status.alarms:
        parts.append(f"ALARM {status.alarms[0].code}: {status.alarms[0].text}")
    return "; ".join(["the engine hangs", *parts] if hung else parts).replace("\n", " ")
