"""Heartbeats both ways, counted in ticks of one second."""

from __future__ import annotations

import threading


class Heartbeats:
    """Our beat goes up while the owner of the machine answers; the panel's beat must change to count as alive.

    A panel that never wrote its beat is not watched.
    """

    def __init__(self, timeout_ticks: int) -> None:
        self._timeout_ticks = timeout_ticks
        self._lock = threading.Lock()
        self._panel_beat: int | None = None
        self._silent_ticks = 0
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
        """The panel wrote its beat; the same value again is none."""
        with self._lock:
            if value != self._panel_beat:
                self._panel_beat, self._silent_ticks = value, 0

    def tick(self, *, service_alive: bool) -> bool:
        """A second has gone by. True where the panel has fallen silent in it."""
        with self._lock:
            if service_alive:
                self._beat = (self._beat + 1) & 0xFFFF
            self._silent_ticks += 1
            return self._panel_beat is not None and self._silent_ticks == self._timeout_ticks
