"""Runs in the process of a command: their start, their progress on stderr, and the exit code at their end."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType

from rich.console import Console

from agent.cli.errors import fail
from agent.cli.run_commands.progress import watching
from agent.cli.run_commands.sequential_options import SequentialOptions
from agent.errors import GateRefused
from agent.execution.supervisor import Supervisor
from agent.planning.job import Job
from agent.runs.consent import Consent
from agent.runs.kinds.calibrate import FullCalibration
from agent.runs.planned_run import Kind
from agent.runs.requested_run import job_of, kind_of
from agent.runs.run_context import RunHooks
from agent.runs.run_request import RunRequest
from agent.runs.session import RunResult, carry_out
from agent.settings.schema import Settings


def calibration_here() -> RunRequest:
    """Return the request for a calibration that is started on the command line.

    The request includes the consent to move the machine, because the person who types the command is at the machine.
    """
    return RunRequest(kind="calibrate", source="command line", consent=True)


def run_here(request: RunRequest, settings: Settings, base: Path, *, nights: float | None = None) -> RunResult:
    """Carry out the run that `request` asks for, in this process and with a progress bar on stderr. Return the result
    of the run. `base` is the directory to which relative paths in the settings refer.

    Ctrl-C aborts the run; SIGTERM and SIGHUP interrupt it. `nights` is the number of nights since the last run whose
    result was accepted as the reference for later runs. If `nights` is None, the number is computed from the calendar.
    """
    job = job_of(request, settings, base)
    return carry_out_here(job, kind_of(request, slot_minutes=request.slot_minutes, nights=nights), base)


def calibrate_here(settings: Settings, base: Path, end: SequentialOptions) -> RunResult:
    """Carry out a calibration in this process and with a progress bar on stderr, as `run_here`. `end` says whether its
    positions are chosen one after the other, and when the measurement ends."""
    kind = FullCalibration(
        consent=Consent.ASK,
        sequential=end.sequential,
        target_vce_um=end.target_vce_um,
        slot_minutes=end.slot_minutes,
    )
    return carry_out_here(job_of(calibration_here(), settings, base), kind, base)


def carry_out_here(job: Job, kind: Kind, base: Path) -> RunResult:
    """Carry out a run of a kind in this process and with a progress bar on stderr. Return the result of the run.
    Ctrl-C aborts the run; SIGTERM and SIGHUP (the terminal has hung up) interrupt it."""
    with watching(Console(stderr=True)) as listener, interruptible() as signals:
        return carry_out(job, kind, base, RunHooks(announce=listener, attach=signals.attach))


class StopSignals:
    """End of a run by signals. Ctrl-C aborts it. Any other signal interrupts it, so that it can be resumed: the
    computer shuts down or the terminal has hung up, and nobody may have wanted the end. The supervisor of the run,
    which receives requests to stop it, may be attached after the signal has come: the run is then ended at once."""

    def __init__(self) -> None:
        self._supervisors: list[Supervisor] = []
        self._received: signal.Signals | None = None

    def attach(self, supervisor: Supervisor) -> None:
        """End the run of `supervisor` on the next signal, or at once if a signal has already come."""
        self._supervisors.append(supervisor)
        if self._received is not None:
            _end(supervisor, self._received)

    def receive(self, number: int, _: FrameType | None = None) -> None:
        """End the runs of the attached supervisors because of the signal `number`."""
        received = signal.Signals(number)
        self._received = self._received or received
        for supervisor in self._supervisors:
            _end(supervisor, received)


def _end(supervisor: Supervisor, received: signal.Signals) -> None:
    request = supervisor.request_abort if received is signal.SIGINT else supervisor.request_interruption
    request(received.name)


@contextmanager
def interruptible() -> Iterator[StopSignals]:
    """Yield the object to which the supervisor of a run can be attached. During the `with` block, Ctrl-C aborts
    this run, and SIGTERM and SIGHUP interrupt it.

    SIGHUP stays ignored if the process was started so, as by `nohup`: its run must outlive the terminal.
    """
    signals, numbers = StopSignals(), [signal.SIGINT, signal.SIGTERM]
    if signal.getsignal(signal.SIGHUP) is not signal.SIG_IGN:
        numbers.append(signal.SIGHUP)
    former = {number: signal.signal(number, signals.receive) for number in numbers}
    try:
        yield signals
    finally:
        for number, handler in former.items():
            signal.signal(number, handler)


def conclude(ended: RunResult) -> None:
    """Return without a value if the new compensation table of the finished run is active and was verified, or if the
    run confirmed the active compensation.

    Otherwise, print the error that describes the outcome, and end the program with the exit code of this error.
    """
    if ended.error is not None:
        raise fail(ended.error)
    if ended.outcome.confirmed is not None:
        return
    proof = ended.outcome.proof
    if proof is None or not proof.accepted:
        reason = "the new table was not better on the held-out positions; the previous table is active again"
        raise fail(GateRefused(reason if proof is None else f"{reason}: {proof.reason}"))
