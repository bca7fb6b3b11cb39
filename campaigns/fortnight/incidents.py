"""Evenings of the fortnight: the requests to the service, the incidents, and the results expected from them."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

from agent.errors import Interrupted
from agent.execution.journal_reader import open_journal
from agent.results.run_outcome import Decision
from agent.service.alarms import CODES
from campaigns.fortnight.evening import Evening, ExpectedRun
from campaigns.fortnight.plant import FortnightPlant
from campaigns.fortnight.service_process import STATUS_POLL_S, TIMEOUT_S, ServiceHost, wait_for
from drivers.roles import Permission

FIRST_EVENING = datetime(2026, 3, 2, tzinfo=UTC)
SLOT = ("--slot", "15min")
FUSED_DECISIONS = (Decision.FUSED.value, Decision.WRITTEN.value)
BALLS_BEFORE_THE_POWER_FAILS = 20
LINK, REFUSED, ABORTED, NOT_NOW = 3, 4, 5, 6
"""Exit codes of `volcal start --wait`."""

GOOD_NIGHT = ExpectedRun("nightly", "complete", "timer", FUSED_DECISIONS)


class Incidents:
    """Incidents of the fortnight on one service host and one simulated plant.

    `by_name` maps the name of each incident to the method that carries out the incident. If `compared` is True, a night
    with a power failure is compared with the same night run without interruption.
    """

    def __init__(self, host: ServiceHost, plant: FortnightPlant, *, compared: bool) -> None:
        self._host = host
        self._plant = plant
        self._compared = compared
        self.by_name: dict[str, Callable[[Evening], None]] = {
            "calibrated by hand": self.by_hand,
            "timer": self.timer,
            "timer at noon": self.at_noon,
            "doors open": self.doors_open,
            "verify": self.verify,
            "power failure": self.power_failure,
            "link loss": self.link_loss,
            "abort": self.abort,
            "damage": self.damage,
            "full calibration": self.full,
        }

    def prepare(self, evening: Evening) -> None:
        """Start the service on the first day of the fortnight."""
        self._set_time(evening, 17)
        self._host.serve()

    # ------------------------------------------------------------------ regular evenings

    def by_hand(self, evening: Evening) -> None:
        """Run a calibration that a person at the machine starts from the web page of the service in the afternoon."""
        self._set_time(evening, 18)
        answer = self._host.post("/api/start", {"kind": "calibrate", "consent": True})
        status = self._host.at_rest(answer.json()["run_id"])
        evening.claims["complete"] = status["state"] == "complete"
        evening.expected.append(ExpectedRun("calibrate", "complete", "page", accepted=True))

    def timer(self, evening: Evening) -> None:
        """Run the nightly command as systemd's timer does every night."""
        self._set_time(evening, 23)
        code, _ = self._ask(evening, *SLOT)
        evening.claims["the timer's command ends well"] = code == 0
        evening.expected.append(GOOD_NIGHT)

    def verify(self, evening: Evening) -> None:
        self._set_time(evening, 23)
        code, _ = self._finish(evening, self._host.timer("verify", evening.station))
        evening.claims["the timer's command ends well"] = code == 0
        evening.expected.append(ExpectedRun("verify", "complete", "timer", (Decision.WITHIN.value,)))

    # ------------------------------------------------------------------ refused by the service

    def at_noon(self, evening: Evening) -> None:
        self._set_time(evening, 12)
        self._expect_refusal(evening, "it is 12:00; unattended runs may start only within 22:00-05:30")

    def doors_open(self, evening: Evening) -> None:
        self._set_time(evening, 22)
        self._plant.permit(Permission.DOORS_CLOSED, False)
        self._expect_refusal(evening, "the machine does not permit motion; missing: doors closed")
        self._plant.permit(Permission.DOORS_CLOSED, True)

    # ------------------------------------------------------------------ interrupted runs

    def power_failure(self, evening: Evening) -> None:
        """Simulate a power failure while the balls of the artefact are measured: the service process is killed, and the
        axes stop where they are.

        Afterwards the service is started again and the interrupted night is resumed. If the incidents were created with
        `compared=True`, the same night is also run without interruption on an identical machine with the same history.
        """
        self._set_time(evening, 23)
        through = self._uninterrupted_estimate(evening) if self._compared else []
        waiting = self._host.timer("nightly", evening.station, *SLOT)
        status = wait_for(self._status_after_balls, "balls", every_s=0.05)
        self._host.kill_service()
        self._set_time(evening, 25)
        self._host.serve()
        self._expect_state(evening, "faulted", CODES[Interrupted].code)
        code, said = self._finish(evening, waiting)
        evening.claims["the timer's command tells it"] = code == ABORTED and "interrupted" in said
        self._sticky_until_reset(evening)
        run_id = str(status["run_id"])
        evening.claims["it can be gone on with"] = self._host.status()["unfinished"] == run_id
        answer = self._host.post("/api/resume-run", {"source": "page"})
        evening.claims["it is the same run"] = answer.json().get("run_id") == run_id
        evening.claims["complete"] = self._host.at_rest(run_id)["state"] == "complete"
        with open_journal(self._host.state) as reader:
            again = [ball.key for ball in reader.balls(reader.require_run(run_id).run)]
        evening.claims["no ball twice"] = len(again) == len(set(again))
        if through:
            apart = largest_difference(through, read_estimate(self._host, run_id))
            evening.figures["largest_difference_sigma"] = apart
            evening.claims["same estimate as uninterrupted"] = apart == 0.0
        evening.expected.append(GOOD_NIGHT)

    def link_loss(self, evening: Evening) -> None:
        """Cut the link to the machine, which had no compensation, after a calibration has activated its new table.

        The agent cannot activate the previous table again until the link is restored.
        """
        with self._plant.without_compensation():
            before = self._plant.active_bank, self._plant.active_crc32
            waiting = self._wait_for_new_table(evening)
            self._plant.cut_link()
            code, _ = self._finish(evening, waiting)
            evening.claims["the timer's command tells it"] = code == LINK
            self._expect_state(evening, "faulted", 311)
            evening.claims["the new table was left acting"] = self._plant.active_bank != before[0]
            self._plant.power_cycle()
            self._sticky_until_reset(evening)
            evening.claims["the table from before acts"] = (self._plant.active_bank, self._plant.active_crc32) == before
            evening.expected.append(ExpectedRun("calibrate", "faulted", "timer", reason="Modbus"))
        self._restart_service()

    def abort(self, evening: Evening) -> None:
        """Abort a calibration of the machine, which had no compensation, from the web page without an access token,
        after it has activated its new compensation table.
        """
        with self._plant.without_compensation():
            before = self._plant.active_bank, self._plant.active_crc32
            waiting = self._wait_for_new_table(evening)
            answer = self._host.post("/api/abort", {"reason": "a person walks in"}, token=False)
            evening.claims["taken without a token"] = answer.status_code == 200
            code, said = self._finish(evening, waiting)
            evening.claims["the timer's command tells it"] = code == ABORTED and "a person walks in" in said
            self._expect_state(evening, "aborted", 470)
            evening.claims["the table from before acts"] = (self._plant.active_bank, self._plant.active_crc32) == before
            self._sticky_until_reset(evening)
            evening.expected.append(ExpectedRun("calibrate", "aborted", "timer", reason="a person walks in"))
        self._restart_service()

    # ------------------------------------------------------------------ damage to the machine

    def damage(self, evening: Evening) -> None:
        self._set_time(evening, 23)
        code, said = self._ask(evening, *SLOT)
        evening.claims["the timer's command tells it"] = code == REFUSED and "a full calibration is" in said
        named = said.partition("at once: ")[2].partition("; ")[0].partition(". ")[0]
        evening.figures["named"] = named
        first = named.startswith("B0Z changed by +")
        evening.claims["named by axis and error"] = first if self._compared else "B0Z changed by +" in named
        expected = ExpectedRun("nightly", "refused", "timer", (Decision.FULL_NEEDED.value,), "B0Z changed by +")
        evening.expected.append(expected)
        if code == REFUSED:
            self._expect_state(evening, "refused", 420)

    def full(self, evening: Evening) -> None:
        """Run a nightly calibration in which a full calibration is allowed, because a person is present and moves the
        artefact.
        """
        self._set_time(evening, 23)
        code, _ = self._ask(evening, "--slot", "3h", "--full-allowed")
        evening.claims["the timer's command ends well"] = code == 0
        expected = ExpectedRun("nightly", "complete", "timer", (Decision.FULL_DONE.value,), accepted=True)
        evening.expected.append(expected)

    # ------------------------------------------------------------------ helpers

    def _restart_service(self) -> None:
        """Stop the service and start it again, and wait until it has read which bank is active."""
        self._host.stop()
        self._host.serve()
        wait_for(
            lambda: self._host.status()["active_bank"] == self._plant.active_bank, "the active bank", STATUS_POLL_S
        )

    def _set_time(self, evening: Evening, hour: int) -> None:
        self._host.set_time(FIRST_EVENING + timedelta(days=evening.night, hours=hour))

    def _ask(self, evening: Evening, *options: str) -> tuple[int, str]:
        return self._finish(evening, self._host.timer("nightly", evening.station, *options))

    def _finish(self, evening: Evening, command: subprocess.Popen[str]) -> tuple[int, str]:
        """Wait for the command to end; return its exit code, and its error output as one line."""
        _, said = command.communicate(timeout=TIMEOUT_S)
        evening.exit_codes.append(command.returncode)
        return command.returncode, " ".join(said.split())

    def _expect_refusal(self, evening: Evening, reason: str) -> None:
        """Add the claims that the request was refused with `reason` and caused neither a new run nor motion."""
        runs = self._runs_and_steps()
        stood = self._plant.position
        found, said = self._ask(evening, *SLOT)
        evening.claims["refused with the reason"] = found == NOT_NOW and reason in said
        evening.claims["moved nothing"] = self._plant.position == stood
        evening.claims["began nothing"] = self._runs_and_steps() == runs

    def _runs_and_steps(self) -> dict[str, int]:
        """Return the number of steps of each run in the journal."""
        with open_journal(self._host.state) as reader:
            return {run.run_id: reader.count_steps(run.run) for run in reader.runs()}

    def _status_after_balls(self) -> dict[str, object] | None:
        status = self._host.status()
        enough = status["state"] == "measuring" and status["balls"] >= BALLS_BEFORE_THE_POWER_FAILS
        return status if enough else None

    def _wait_for_new_table(self, evening: Evening) -> subprocess.Popen[str]:
        self._set_time(evening, 23)
        before = self._plant.active_bank
        waiting = self._host.command("start", "--kind", "calibrate", "--wait", timer=True)
        wait_for(lambda: self._plant.active_bank != before or waiting.poll() is not None, "a new table")
        if waiting.poll() is not None:
            raise RuntimeError(f"night {evening.night + 1} wrote no table: {self._host.status()}")
        return waiting

    def _expect_state(self, evening: Evening, state: str, code: int) -> None:
        status = wait_for(lambda: self._in_state(state), f"the state {state}", STATUS_POLL_S)
        evening.claims[f"{state}, alarm {code}"] = [alarm["code"] for alarm in status["alarms"]][:1] == [code]

    def _in_state(self, state: str) -> dict[str, Any] | None:
        status = self._host.status()
        return status if status["state"] == state else None

    def _sticky_until_reset(self, evening: Evening) -> None:
        answer = self._host.post("/api/start", {"kind": "nightly", "source": "timer"})
        evening.claims["sticky until reset"] = answer.status_code == 409 and "reset" in answer.json()["hint"]
        self._host.command("reset").communicate(timeout=TIMEOUT_S)
        evening.claims["idle after the reset"] = self._host.status()["state"] == "idle"

    def _uninterrupted_estimate(self, evening: Evening) -> list[tuple[str, float, float]]:
        """Return the estimate of the same night, run without interruption on a duplicate of the plant."""
        twin = self._plant.duplicate()
        directory = Path(self._host.directory, "twin")
        with self._host.copy(directory, twin.ready) as other:
            other.serve()
            command = other.timer("nightly", evening.station, *SLOT)
            run_id = command.communicate(timeout=TIMEOUT_S)[0].strip()
            other.stop()
            twin.switch_off()
            return read_estimate(other, run_id)


def read_estimate(host: ServiceHost, run_id: str) -> list[tuple[str, float, float]]:
    """Return the name, the value and the standard uncertainty of every parameter of the estimate of a run.

    The run must have exactly one estimate.
    """
    with open_journal(host.state) as reader:
        [text] = reader.estimates(reader.require_run(run_id).run)
    parameters = json.loads(text)["parameters"]
    return [(one["name"], one["value"], one["standard_uncertainty"]) for one in parameters]


def largest_difference(one: list[tuple[str, float, float]], other: list[tuple[str, float, float]]) -> float:
    """Return the largest difference between two estimates, in units of the standard uncertainty of the estimate `one`.

    An estimate is a list of items (name, value, standard uncertainty). The two lists must contain the same names in the
    same order.
    """
    assert [name for name, _, _ in one] == [name for name, _, _ in other]
    return max(abs(a - b) / sigma for (_, a, sigma), (_, b, _) in zip(one, other, strict=True))
