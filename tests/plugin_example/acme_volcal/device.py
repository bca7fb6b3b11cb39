"""Device with the roles Machine and Probe of an ACME controller. A device has a role if it implements its methods."""

from __future__ import annotations

import numpy as np

from acme_volcal.line import AcmeLine
from drivers.clock import Clock, Deadline
from drivers.errors import CommandRejected, DeviceError, GuardTripped, MotionFault
from drivers.roles import (
    AxisLimits,
    DiagnosticFinding,
    MachineStatus,
    Miss,
    MotionState,
    Permission,
    ProbeStatus,
    Touch,
    Vector,
)

POLL_S = 0.05
MARGIN_S = 5.0


class AcmeCnc:
    """ACME controller. Waits use the given clock; if an exception ends a wait, the motion is stopped first."""

    def __init__(self, address: tuple[str, int], timeout_s: float, clock: Clock, name: str) -> None:
        self._line = AcmeLine(address, timeout_s, name)
        self._clock = clock

    # Device

    def open(self) -> None:
        self._line.open()

    def close(self) -> None:
        self._line.close()

    def diagnose(self) -> list[DiagnosticFinding]:
        """Return findings on link, state and permissions; reads only."""
        opened_here = not self._line.connected
        try:
            if opened_here:
                self._line.open()
            status = self.status()
            return [
                DiagnosticFinding("link", ok=True, text=self._line.where["link"]),
                DiagnosticFinding("state", ok=status.state is not MotionState.FAULT, text=status.state.value),
                DiagnosticFinding("permissions", ok=not status.missing, text=f"{len(status.missing)} missing"),
            ]
        except DeviceError as error:
            return [DiagnosticFinding("link", ok=False, text=str(error))]
        finally:
            if opened_here:
                self._line.close()

    # Machine

    def limits(self) -> AxisLimits:
        numbers = self._numbers("limits")
        lower, upper, rapid, acceleration = (numbers[i : i + 3] for i in range(0, 12, 3))
        return AxisLimits(lower, upper, rapid, acceleration)

    def status(self) -> MachineStatus:
        state, ready = self._ask("status")
        return MachineStatus(MotionState(state), dict.fromkeys(Permission, ready == "ready"))

    def position(self) -> Vector:
        return np.array(self._numbers("position"))

    def move_to(self, target_mm: Vector, *, feed_mm_per_s: float | None, guarded: bool) -> None:
        outcome = self._run("guarded" if guarded else "move", target_mm, feed_mm_per_s)
        if outcome == "tripped":
            self._ask("reset")
            raise GuardTripped("the probe tripped in a move that was not a touch", **self._line.where)

    def hold(self) -> None:
        self._ask("hold")

    def resume(self) -> None:
        self._ask("resume")

    def reset(self) -> None:
        self._ask("reset")

    def stop(self) -> None:
        if self._line.connected:
            self._ask("stop")

    # Probe

    def probe_status(self) -> ProbeStatus:
        (state,) = self._ask("probe")
        return ProbeStatus(loaded=True, healthy=True, deflected=state == "deflected")

    def touch_towards(self, target_mm: Vector, *, feed_mm_per_s: float) -> Touch | Miss:
        outcome = self._run("touch", target_mm, feed_mm_per_s)
        x, y, z = self._numbers("latch")
        return Touch((x, y, z)) if outcome == "tripped" else Miss((x, y, z))

    # helpers

    def _run(self, kind: str, target_mm: Vector, feed_mm_per_s: float | None) -> str:
        """Start a motion and wait for its outcome."""
        x, y, z = (float(value) for value in target_mm)
        start = self.position()
        feed = "rapid" if feed_mm_per_s is None else f"{feed_mm_per_s!r}"
        speed = min(self.limits().rapid_mm_per_s) if feed_mm_per_s is None else feed_mm_per_s
        self._ask(f"{kind} {x!r} {y!r} {z!r} {feed}")
        try:
            allowed_s = 1.5 * float(np.linalg.norm(target_mm - start)) / speed + MARGIN_S
            deadline = Deadline.after(self._clock, allowed_s)
            while (outcome := self._ask("outcome")[0]) == "moving":
                deadline.raise_if_expired(f"the end of {kind}", hint="check the controller", **self._line.where)
                self._clock.sleep(POLL_S)
        except BaseException as error:
            try:
                self.stop()
            except DeviceError as failure:
                error.add_note(f"stop after this failed: {failure}")
            raise
        if outcome not in ("reached", "tripped"):
            raise MotionFault(f"{kind} ended as {outcome}", hint="check the controller", **self._line.where)
        return outcome

    def _numbers(self, question: str) -> tuple[float, ...]:
        return tuple(float(word) for word in self._ask(question))

    def _ask(self, question: str) -> list[str]:
        verdict, *words = self._line.ask(question)
        if verdict == "no":
            raise CommandRejected(f"{question!r} refused: {' '.join(words)}", **self._line.where)
        return words
