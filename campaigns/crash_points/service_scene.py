"""The command `volcal serve` in a process of its own that can be killed, beside a simulated machine that can be killed,
too."""

from __future__ import annotations

import sqlite3
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import httpx

from agent.cli.run_commands import resume as resume_command
from agent.cli.service_commands import serve as serve_command
from agent.execution.engine import Engine
from agent.execution.journal_reader import has_journal, open_journal
from agent.execution.journal_rows import RunRow
from agent.execution.journal_schema import FILE_NAME
from agent.execution.steps import Step
from agent.planning.case_file import SHIPPED_CONFIGURATION
from agent.runs.reference_state import ACTIVATING_DECISIONS
from agent.service import address_file
from agent.service.allowed_requests import AT_REST
from agent.service.state.reports import ReportQueue
from campaigns.aborts.case import FORMER_TABLE, POSITIONS, SCALE
from campaigns.crash_points.crash_recorder import MEASURING, watched_commits
from campaigns.crash_points.death_point import DeathPoint
from campaigns.crash_points.forked_process import ForkedProcess, forked_command, wait_for
from campaigns.crash_points.kept_simulator import KeptSimulator
from campaigns.fortnight.service_process import settings_text
from drivers.links.modbus import ModbusLink
from simulators.scenario import read_scenario
from simulators.wire.modbus.register_map import READ_SELECTOR

Document = dict[str, Any]
COMMANDS = (serve_command, resume_command)
"""Modules of the commands that are started. They are imported here, so that no start has to."""
BEFORE_WRITE, AFTER_WRITE = "before a write to the controller", "after a write to the controller"
STATUS_POLL_S = 0.05
ENDED = frozenset(state.value for state in AT_REST)
WEIGHT = 20
"""Weight of a point while nothing is measured. Measuring has some fifty times as many points as the rest of a run."""
TABLE_STEP_MM = "[500.0, 325.0, 500.0]"
"""Steps of the table, with which it has some blocks only, so that each command for it is met often."""
CHANGES = {
    'position_set = "S3"': 'position_set = "positions.csv"\nstations = [1]',
    "[verification]\nstations = [1, 4]": (
        "[verification]\nstations = [1]\npositions_deg = [[20.0, 25.0]]\nmax_chi2 = 1e3"
    ),
    "port = 5020\n\n": "port = {modbus}\nreconnect_attempts = 1\n\n",
    "[timing]": (
        "[gates]\nmin_degrees_of_freedom = 1\nmax_unmeasured_fraction = 10.0\nmax_chi2 = 1e3\n"
        f"max_correction_um = 1e3\n\n[table]\nstep_mm = {TABLE_STEP_MM}\n\n[timing]"
    ),
}


class ServiceScene:
    """State directory of one machine, its simulated machine, and the present process of its service.

    `proved` are the tables that may act, each as bank and CRC-32: the former one, and those that a run has accepted or
    that a restoration was asked for. `acknowledged` has the largest number of balls that the service has told of each
    run.
    """

    def __init__(self, directory: Path) -> None:
        shipped = read_scenario(SHIPPED_CONFIGURATION / "simulators" / "case-study.toml")
        truth = shipped.settings.truth.model_copy(update={"scale": SCALE})
        settings = shipped.settings.model_copy(update={"truth": truth, "noise_by_step": True})
        self.simulator = KeptSimulator(replace(shipped, settings=settings), directory, FORMER_TABLE)
        self.simulator.start()
        self.death = DeathPoint()
        self.config, self.state = directory / "volcal.toml", directory / "state"
        (directory / "positions.csv").write_text(POSITIONS)
        port = self.simulator.ready["modbus"]["port"]
        changes = {former: now.replace("{modbus}", str(port)) for former, now in CHANGES.items()}
        self.config.write_text(settings_text(self.simulator.ready, changes))
        self.proved = {self.simulator.truth.table}
        self.acknowledged: dict[str, int] = {}
        self._directory = directory
        self._service: ForkedProcess | None = None
        self._http: httpx.Client | None = None

    def close(self) -> None:
        if self._service is not None:
            self._service.kill()
        if self._http is not None:
            self._http.close()
        self.simulator.kill()

    # ------------------------------------------------------------------ processes

    def serve(self) -> bool:
        """Start the service. Return False if it dies before it answers."""
        if self._http is not None:
            self._http.close()
        (self.state / address_file.ADDRESS_FILE).unlink(missing_ok=True)  # left by a service that was killed
        arguments = ["serve", "--config", str(self.config)]
        self._service = forked_command(arguments, self._directory / "service.log", self._watch)
        wait_for(lambda: (self.state / address_file.ADDRESS_FILE).exists() or self.dead, "the service")
        if self.dead:
            return False
        token = (self.state / "token").read_text().strip()
        self._http = httpx.Client(
            base_url=address_file.read_address(self.state),
            headers={"Authorization": f"Bearer {token}"},
            timeout=120.0,
            trust_env=False,
        )
        return True

    @property
    def dead(self) -> bool:
        return self._service is None or self._service.ended

    def require_killed(self) -> None:
        """Raise RuntimeError if the service has ended by itself."""
        assert self._service is not None
        if self._service.await_end() != -9:
            raise RuntimeError(f"the service ended by itself: {self._service.log.read_text()[-3000:]}")

    def command(self, *arguments: str) -> tuple[int, str]:
        """Carry out a command of `volcal` beside the service, and return its exit code and its output."""
        log = self._directory / "command.log"
        log.unlink(missing_ok=True)
        code = forked_command([*arguments, "--config", str(self.config)], log).await_end()
        return code, log.read_text()

    def _watch(self) -> None:
        """Pass a death point around each commit and around each write to the controller, in the process of the
        service."""
        key, death = ["no step"], self.death
        carry_out = Engine._do_durably

        def noted(engine: Engine, step: Step) -> Any:
            key[0] = step.key
            return carry_out(engine, step)

        def notify(point: str) -> None:
            death.passed(f"{point}: {key[0]}", 1 if key[0].startswith(MEASURING) else WEIGHT)

        def around(real: Callable[..., Any]) -> Callable[..., Any]:
            def write(link: ModbusLink, register: int, *values: Any, **named: Any) -> Any:
                if READ_SELECTOR.holds(register, 1):  # it only selects what the controller shows
                    return real(link, register, *values, **named)
                notify(BEFORE_WRITE)
                result = real(link, register, *values, **named)
                notify(AFTER_WRITE)
                return result

            return write

        Engine._do_durably = noted  # type: ignore[method-assign, assignment]
        ModbusLink.write, ModbusLink.exchange = around(ModbusLink.write), around(ModbusLink.exchange)  # type: ignore[method-assign]
        ReportQueue.request = lambda *_: None  # type: ignore[method-assign]  # a report takes seconds, and writes no table
        self._commits = watched_commits(notify)  # kept, since it ends when nothing refers to it any more
        self._commits.__enter__()

    # ------------------------------------------------------------------ requests

    def post(self, path: str, body: Document | None = None) -> httpx.Response | None:
        """Make a request. Return None if the service has died meanwhile."""
        assert self._http is not None
        try:
            return self._http.post(path, json=body)
        except httpx.TransportError:
            self.require_killed()
            return None

    def status(self) -> Document | None:
        """Return the status, and note what it acknowledges; None if the service has died."""
        assert self._http is not None
        try:
            status: Document = self._http.get("/api/status").json()
        except httpx.TransportError:
            self.require_killed()
            return None
        if status["run_id"] is not None:
            told = self.acknowledged.get(status["run_id"], 0)
            self.acknowledged[status["run_id"]] = max(told, status["balls"])
        return status

    def at_rest(self) -> Document | None:
        """Wait until no run is in progress, and return the status; None if the service has died."""

        def ended() -> tuple[Document | None] | None:
            status = self.status()
            return (status,) if status is None or status["state"] in ENDED else None

        return wait_for(ended, "the end of the run", STATUS_POLL_S)[0]

    # ------------------------------------------------------------------ the journal

    def last_run(self) -> RunRow | None:
        if not has_journal(self.state):
            return None
        with open_journal(self.state) as reader:
            return reader.last_run()

    def note_proved(self) -> None:
        """Add the tables that the journal proves: accepted ones with touches of their verification, and those whose
        restoration was asked for."""
        if not has_journal(self.state):
            return
        with open_journal(self.state) as reader:
            for row in reader.runs():
                if not reader.has_decision(row.run, ACTIVATING_DECISIONS):
                    continue
                if row.kind != "restore" and not any(one.key.startswith("verify/") for one in reader.touches(row.run)):
                    continue
                self.proved |= {(one.bank, one.crc32 or 0) for one in reader.tables(row.run) if one.role == "staged"}

    def lost(self) -> str:
        """Return in words what the journal lacks of what was acknowledged, or how it is damaged; empty if nothing."""
        if not has_journal(self.state):
            return "the journal is missing" if self.acknowledged else ""
        connection = sqlite3.connect(self.state / FILE_NAME)
        try:
            [(verdict,)] = connection.execute("PRAGMA integrity_check").fetchall()
        finally:
            connection.close()
        if verdict != "ok":
            return f"the journal is damaged: {verdict}"
        with open_journal(self.state) as reader:
            for run_id, balls in self.acknowledged.items():
                row = reader.run(run_id)
                found = 0 if row is None else reader.count_balls(row.run)
                if found < balls:
                    return f"{found} of {balls} acknowledged balls of run {run_id} are in the journal"
        return ""

    def other_table(self, role: str | None = None) -> Document:
        """Return a request that restores a table of the first calibration which has written one: the former table
        ("backup") or the new one ("staged"). If `role` is None, it is the one that does not act."""
        with open_journal(self.state) as reader:
            written = (row for row in reader.runs() if row.kind == "calibrate" and reader.last_table(row.run, "staged"))
            run = next(written)
            backup = reader.last_table(run.run, "backup")
        acts = backup is not None and (backup.crc32 or 0) == self.simulator.truth.table[1]
        chosen = role or ("staged" if acts else "backup")
        return {"run_id": run.run_id, "role": chosen, "source": "page"}

    def is_acknowledged(self, row: RunRow) -> bool:
        """Return True if a reset has acknowledged the end of the run."""
        with open_journal(self.state) as reader:
            return reader.last_event_number(row.run, "acknowledged") > reader.last_event_number(row.run, "state")
