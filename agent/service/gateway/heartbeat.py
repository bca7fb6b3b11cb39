"""Heartbeats of the service and of the panel, counted in ticks of 1 s."""

from __future__ import annotations

import threading


class Heartbeats:
    """Two counters that show that the service and the panel are alive.

    The counter of the service increases while the owner of the machine responds. The panel must keep changing its own
    counter. A panel that has never written its counter is not monitored.
    """

    def __init__(self, timeout_ticks: int) -> None:
        self._timeout_ticks = timeout_ticks
        self._lock = threading.Lock()
        self._panel_beat: int | None = None
        self._silent_ticks = 0
        self._held_run: str | None = None
        self._beat = 0

    @property
    def service_beat(self) -> int:
        return self._beat

    @property
    def panel_beat(self) -> int | None:
        return self._panel_beat

    @property
    def panel_alive(self) -> bool:
        with self._lock:
            return self._panel_beat is not None and self._silent_ticks < self._timeout_ticks

    def beat(self, value: int) -> None:
        """Store a counter value written by the panel. A value that equals the previous value does not prove that the
        panel is alive."""
        with self._lock:
            if value != self._panel_beat:
                self._panel_beat, self._silent_ticks, self._held_run = value, 0, None

    def hold_due(self, run_id: str) -> bool:
        """Return True if the panel's timeout has expired and the run `run_id` was not held in this silence."""
        with self._lock:
            silent = self._panel_beat is not None and self._silent_ticks >= self._timeout_ticks
            return silent and run_id != self._held_run

    def held(self, run_id: str) -> None:
        """Remember that the run `run_id` was held, so that whoever resumes it can go on without the panel."""
        with self._lock:
            self._held_run = run_id

    def tick(self, *, service_alive: bool) -> bool:
        """Count one second. Return True if the panel's timeout has expired in this second."""
        with self._lock:
            if service_alive:
                self._beat = (self._beat + 1) & 0xFFFF
            self._silent_ticks += 1
            return self._panel_beat is not None and self._silent_ticks == self._timeout_ticks
