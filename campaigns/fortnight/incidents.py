"""Evenings of the fortnight: what is asked of the service, what goes wrong, and what must come of it."""

from __future__ import annotations

import json
import subprocess
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path

from agent.execution.journal_reader import open_journal
from agent.results.run_outcome import Decision
from agent.service.state.journal_state import INTERRUPTED_CODE
from campaigns.fortnight.evening import Evening, Expected
from campaigns.fortnight.house import ASK_EVERY_S, PATIENCE_S, House, wait_for
from campaigns.fortnight.plant import Plant
from drivers.roles import Permission

FIRST_EVENING = datetime(2026, 3, 2, tzinfo=UTC)
SLOT = ("--slot", "15min")
FUSED = (Decision.FUSED.value, Decision.WRITTEN.value)
LOOKED_ONLY = (None, Decision.WITHIN.value)
"""Of a night that broke off: its verification stands, nothing of it was accepted."""
BALLS_BEFORE_THE_POWER_FAILS = 20
LINK, REFUSED, ABORTED, NOT_NOW = 3, 4, 5, 6
"""Exit codes of `volcal start --wait`."""

GOOD_NIGHT = Expected("nightly", "complete", "timer", FUSED)


class Incidents:
    """One house and one plant; every method is an evening, or the beginning of one, by its name in `by_name`.
    `compared`: what broke off is compared with the same night gone through."""

    def __init__(self, house: House, plant: Plant, *, compared: bool) -> None:
        self._house = house
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
        """The service is started on the first day."""
        self._is(evening, 17)
        self._house.serve()

    # ------------------------------------------------------------------ evenings as they should be

    def by_hand(self, evening: Evening) -> None:
        """Somebody stands at the machine with the page open, in the afternoon."""
        self._is(evening, 18)
        answer = self._house.post("/api/start", {"kind": "calibrate", "consent": True})
        status = self._house.at_rest(answer.json()["run_id"])
        evening.claims["complete"] = status["state"] == "complete"
        evening.expected.append(Expected("calibrate", "complete", "page", accepted=True))

    def timer(self, evening: Evening) -> None:
        """What systemd's timer does every night."""
        self._is(evening, 23)
        code, _ = self._asked(evening, *SLOT)
        evening.claims["the timer's command ends well"] = code == 0
        evening.expected.append(GOOD_NIGHT)

    def verify(self, evening: Evening) -> None:
        self._is(evening, 23)
        code, _ = self._ended(evening, self._house.timer("verify", evening.station))
        evening.claims["the timer's command ends well"] = code == 0
        evening.expected.append(Expected("verify", "complete", "timer", (Decision.WITHIN.value,)))

    # ------------------------------------------------------------------ what the service refuses by itself

    def at_noon(self, evening: Evening) -> None:
        self._is(evening, 12)
        self._refused(evening, "it is 12:00, and nothing may begin by itself outside 22:00-05:30")

    def doors_open(self, evening: Evening) -> None:
        self._is(evening, 22)
        self._plant.permit(Permission.DOORS_CLOSED, False)
        self._refused(evening, "the machine does not permit motion; missing: doors closed")
        self._plant.permit(Permission.DOORS_CLOSED, True)

    # ------------------------------------------------------------------ what breaks off

    def power_failure(self, evening: Evening) -> None:
        """In the middle of measuring; the machine stays as it stands. The same night on a machine and a past that are
        the same goes through beside it."""
        self._is(evening, 23)
        through = self._gone_through(evening) if self._compared else []
        waiting = self._house.timer("nightly", evening.station, *SLOT)
        status = wait_for(self._measured, "balls", every_s=0.05)
        self._house.power_fails()
        self._is(evening, 25)
        self._house.serve()
        self._stands(evening, "faulted", INTERRUPTED_CODE)
        code, said = self._ended(evening, waiting)
        evening.claims["the timer's command tells it"] = code == ABORTED and "interrupted" in said
        self._sticky_until_reset(evening)
        run_id = str(status["run_id"])
        evening.claims["it can be gone on with"] = self._house.status()["unfinished"] == run_id
        answer = self._house.post("/api/resume-run", {"source": "page"})
        evening.claims["it is the same run"] = answer.json().get("run_id") == run_id
        evening.claims["complete"] = self._house.at_rest(run_id)["state"] == "complete"
        with open_journal(self._house.state) as reader:
            again = [ball.key for ball in reader.balls(reader.require_run(run_id).run)]
        evening.claims["no ball twice"] = len(again) == len(set(again))
        if through:
            apart = largest_difference(through, estimate_of(self._house, run_id))
            evening.told["largest_difference_sigma"] = apart
            evening.claims["same estimate as uninterrupted"] = apart == 0.0
        evening.expected.append(GOOD_NIGHT)

    def link_loss(self, evening: Evening) -> None:
        """Behind the activation: nothing can be written back until the link is whole."""
        before = self._plant.active_bank, self._plant.active_crc32
        waiting = self._until_a_new_table_acts(evening)
        self._plant.cut_the_link()
        code, _ = self._ended(evening, waiting)
        evening.claims["the timer's command tells it"] = code == LINK
        self._stands(evening, "faulted", 311)
        evening.claims["the new table was left acting"] = self._plant.active_bank != before[0]
        self._plant.power_cycle()
        self._sticky_until_reset(evening)
        evening.claims["the table from before acts"] = (self._plant.active_bank, self._plant.active_crc32) == before
        evening.expected.append(Expected("nightly", "faulted", "timer", LOOKED_ONLY, "Modbus"))

    def abort(self, evening: Evening) -> None:
        """Behind the activation, from the page, without a token."""
        before = self._plant.active_bank, self._plant.active_crc32
        waiting = self._until_a_new_table_acts(evening)
        answer = self._house.post("/api/abort", {"reason": "a person walks in"}, token=False)
        evening.claims["taken without a token"] = answer.status_code == 200
        code, said = self._ended(evening, waiting)
        evening.claims["the timer's command tells it"] = code == ABORTED and "a person walks in" in said
        self._stands(evening, "aborted", 470)
        evening.claims["the table from before acts"] = (self._plant.active_bank, self._plant.active_crc32) == before
        self._sticky_until_reset(evening)
        evening.expected.append(
            Expected("nightly", "aborted", "timer", (None, Decision.WITHIN.value), "a person walks in")
        )

    # ------------------------------------------------------------------ what the machine suffers

    def damage(self, evening: Evening) -> None:
        self._is(evening, 23)
        code, said = self._asked(evening, *SLOT)
        evening.claims["the timer's command tells it"] = code == REFUSED and "a full calibration is" in said
        named = said.partition("at once: ")[2].partition("; ")[0].partition(". ")[0]
        evening.told["named"] = named
        first = named.startswith("B0Z changed by +")
        evening.claims["named by axis and error"] = first if self._compared else "B0Z changed by +" in named
        expected = Expected("nightly", "refused", "timer", (Decision.FULL_NEEDED.value,), "B0Z changed by +")
        evening.expected.append(expected)
        if code == REFUSED:
            self._stands(evening, "refused", 420)

    def full(self, evening: Evening) -> None:
        """Somebody carries the artefact tonight."""
        self._is(evening, 23)
        code, _ = self._asked(evening, "--slot", "3h", "--full-allowed")
        evening.claims["the timer's command ends well"] = code == 0
        expected = Expected("nightly", "complete", "timer", (Decision.FULL_DONE.value,), accepted=True)
        evening.expected.append(expected)

    # ------------------------------------------------------------------ parts of them

    def _is(self, evening: Evening, hour: int) -> None:
        self._house.is_now(FIRST_EVENING + timedelta(days=evening.night, hours=hour))

    def _asked(self, evening: Evening, *options: str) -> tuple[int, str]:
        return self._ended(evening, self._house.timer("nightly", evening.station, *options))

    def _ended(self, evening: Evening, command: subprocess.Popen[str]) -> tuple[int, str]:
        """Exit code, and what it said on one line."""
        _, said = command.communicate(timeout=PATIENCE_S)
        evening.asked.append(command.returncode)
        return command.returncode, " ".join(said.split())

    def _refused(self, evening: Evening, reason: str) -> None:
        """With the reason; nothing is begun and nothing moves."""
        runs = self._runs_and_steps()
        stood = self._plant.position
        found, said = self._asked(evening, *SLOT)
        evening.claims["refused with the reason"] = found == NOT_NOW and reason in said
        evening.claims["moved nothing"] = self._plant.position == stood
        evening.claims["began nothing"] = self._runs_and_steps() == runs

    def _runs_and_steps(self) -> dict[str, int]:
        """How many steps each run of the journal has."""
        with open_journal(self._house.state) as reader:
            return {run.run_id: reader.count_steps(run.run) for run in reader.runs()}

    def _measured(self) -> dict[str, object] | None:
        status = self._house.status()
        enough = status["state"] == "measuring" and status["balls"] >= BALLS_BEFORE_THE_POWER_FAILS
        return status if enough else None

    def _until_a_new_table_acts(self, evening: Evening) -> subprocess.Popen[str]:
        self._is(evening, 23)
        before, waiting = self._plant.active_bank, self._house.timer("nightly", evening.station, *SLOT)
        wait_for(lambda: self._plant.active_bank != before or waiting.poll() is not None, "a new table")
        if waiting.poll() is not None:
            raise RuntimeError(f"night {evening.night + 1} wrote no table: {self._house.status()}")
        return waiting

    def _stands(self, evening: Evening, state: str, code: int) -> None:
        status = wait_for(lambda: self._in_state(state), f"the state {state}", ASK_EVERY_S)
        evening.claims[f"{state}, alarm {code}"] = [alarm["code"] for alarm in status["alarms"]][:1] == [code]

    def _in_state(self, state: str) -> dict[str, object] | None:
        status = self._house.status()
        return status if status["state"] == state else None

    def _sticky_until_reset(self, evening: Evening) -> None:
        answer = self._house.post("/api/start", {"kind": "nightly", "source": "timer"})
        evening.claims["sticky until reset"] = answer.status_code == 409 and "reset" in answer.json()["hint"]
        self._house.command("reset").communicate(timeout=PATIENCE_S)
        evening.claims["idle after the reset"] = self._house.status()["state"] == "idle"

    def _gone_through(self, evening: Evening) -> list[tuple[str, float, float]]:
        """The estimate of this very night where nothing happens to it."""
        twin = self._plant.twin()
        directory = Path(self._house.directory, "twin")
        with self._house.copy(directory, twin.ready) as other:
            other.serve()
            command = other.timer("nightly", evening.station, *SLOT)
            run_id = command.communicate(timeout=PATIENCE_S)[0].strip()
            other.stop()
            twin.switch_off()
            return estimate_of(other, run_id)


def estimate_of(house: House, run_id: str) -> list[tuple[str, float, float]]:
    """Name, value and standard uncertainty of every parameter."""
    with open_journal(house.state) as reader:
        [text] = reader.estimates(reader.require_run(run_id).run)
    parameters = json.loads(text)["parameters"]
    return [(one["name"], one["value"], one["standard_uncertainty"]) for one in parameters]


def largest_difference(one: list[tuple[str, float, float]], other: list[tuple[str, float, float]]) -> float:
    """In standard uncertainties."""
    assert [name for name, _, _ in one] == [name for name, _, _ in other]
    return max(abs(a - b) / sigma for (_, a, sigma), (_, b, _) in zip(one, other, strict=True))
