"""What the main thread does while the service lives: signals, systemd's watchdog and status text."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, SimpleQueue
from types import FrameType

import structlog

from agent.service.control import Status
from agent.service.daemon.sd_notify import Notifier
from agent.service.owner.health import Health
from agent.service.owner.owner import Owner
from agent.settings.load import load_settings
from drivers.clock import RealClock
from drivers.errors import VolcalError

log = structlog.get_logger()

SIGNALS = (signal.SIGTERM, signal.SIGINT, signal.SIGHUP)
LOOK_EVERY_S = 1.0
FEEDS_A_PERIOD = 3.0
"""sd_watchdog_enabled(3) advises to feed at least twice in a period."""
US_PER_S = 1e6


@contextmanager
def heard_signals() -> Iterator[SimpleQueue[int]]:
    """For the block the signals end up in the queue instead of ending the process."""
    queue: SimpleQueue[int] = SimpleQueue()

    def hear(number: int, _: FrameType | None) -> None:
        queue.put(number)

    former = {number: signal.signal(number, hear) for number in SIGNALS}
    try:
        yield queue
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


@dataclass
class Life:
    """Lives until it is told to end."""

    owner: Owner
    health: Health
    notifier: Notifier
    signals: SimpleQueue[int]
    config: Path
    _said: str = ""
    _hung: bool = False

    def live(self) -> None:
        """Ready; then feed, tell and reload, until SIGTERM or SIGINT; then hold, withdraw and close."""
        self.owner.reconcile_if_reached()
        self.notifier.send(READY=1, STATUS=self._text())
        period_s = LOOK_EVERY_S
        if self.notifier.watchdog_s is not None:
            period_s = min(period_s, self.notifier.watchdog_s / FEEDS_A_PERIOD)
        while (number := self._signal(period_s)) not in (signal.SIGTERM, signal.SIGINT):
            if number == signal.SIGHUP:
                self._reload()
            self._feed()
        self._end(signal.Signals(number).name if number is not None else "")

    def _signal(self, within_s: float) -> int | None:
        try:
            return self.signals.get(timeout=within_s)
        except Empty:
            return None

    def _feed(self) -> None:
        """Nothing where the engine hangs: then systemd ends this process, and the machine's own watchdog has stopped
        it long before."""
        if self.health.alive(self.owner.status().state):
            self._hung = False
            self.notifier.send(WATCHDOG=1)
        elif not self._hung:
            self._hung = True
            log.error("the engine hangs", silent_s=round(self.health.silent_s(), 1))
        self._tell()

    def _tell(self) -> None:
        text = self._text()
        if text != self._said:
            self._said = text
            self.notifier.send(STATUS=text)

    def _text(self) -> str:
        return status_text(self.owner.status(), hung=self._hung)

    def _reload(self) -> None:
        """The settings file again, for the runs to come; what is wrong with it is said, and the old ones stay."""
        self.notifier.send(RELOADING=1, MONOTONIC_USEC=int(US_PER_S * RealClock().now()))
        try:
            self.owner.reload(load_settings(self.config))
        except VolcalError as error:
            log.error("the settings were not reloaded; those from before stay", reason=str(error))
            text = f"settings not reloaded: {error}"
        else:
            log.info("the settings were reloaded")
            text = self._text()
        self.notifier.send(READY=1, STATUS=text)

    def _end(self, name: str) -> None:
        within_s = self.owner.settings.service.stop_timeout_s
        log.info("ending", asked_by=name, within_s=within_s)
        self.notifier.send(
            STOPPING=1, STATUS="stopping: withdrawing the probe", EXTEND_TIMEOUT_USEC=int(US_PER_S * within_s)
        )
        if not self.owner.close(within_s):
            log.error("the run did not end in time; the process ends with it", within_s=within_s)


def status_text(status: Status, *, hung: bool = False) -> str:
    """One line for `systemctl status`."""
    parts = [f"{status.machine}: {status.doing}"]
    if status.minutes_left is not None:
        parts.append(f"{100.0 * status.fraction:.0f} %, {status.minutes_left:.0f} min left")
    if status.alarms:
        parts.append(f"ALARM {status.alarms[0].code}: {status.alarms[0].text}")
    return "; ".join(["the engine hangs", *parts] if hung else parts).replace("\n", " ")
