"""Models of the answers about the history, from which the OpenAPI document is generated."""

from __future__ import annotations

from pydantic import BaseModel

from agent.service.http.models import AlarmView, VerdictView


class HistoryRun(BaseModel):
    """Run in the history of the machine. `number` counts the runs of the machine in the order of their start, from 1.

    The times are in UTC. The figures are those of `RunSummary`. `report` is true if the run has ended and is in the
    journal of this machine, from which its report can be made.
    """

    number: int
    run_id: str
    kind: str
    started: str
    ended: str | None
    state: str
    reason: str
    started_by: str
    balls: int
    touches: int
    machine_minutes: float
    verdict: VerdictView
    ve_um: float | None
    vce_um: float | None
    held_out_before_um: float | None
    held_out_after_um: float | None
    report: bool


class HistoryRunList(BaseModel):
    """Selected runs of one page, the latest first. `total` is the number of all selected runs; `kinds` and `verdicts`
    are the numbers of all runs of the machine by kind and by the name of the verdict."""

    machine: str
    runs: list[HistoryRun]
    total: int
    kinds: dict[str, int]
    verdicts: dict[str, int]


class HistoryAlarm(BaseModel):
    """Alarm of the run `run_id` of the kind `kind`, from the UTC time `since` to `until`: until it was acknowledged,
    the run was resumed or the next run began. `until` is null if none of these is recorded. `run_id` and `kind` are
    empty if the alarm arose between runs."""

    since: str
    until: str | None
    run_id: str
    kind: str
    alarm: AlarmView


class HistoryAlarmList(BaseModel):
    """Alarms of one page, the latest first, and the number of all alarms."""

    alarms: list[HistoryAlarm]
    total: int


class PlantMachine(BaseModel):
    """Machine in the history database with its last run, which started `days` days ago.

    `ve_um`, `vce_um` and `held_out_um` are the newest known figures. The drift is that of the VE without a table over
    the latest runs, in µm per night, with its expanded uncertainty (95 %); both are null if there are too few values.
    `dated_ahead` are the runs that are dated in the future; they do not count unless all are.
    """

    machine: str
    run_id: str
    kind: str
    started: str
    days: float
    verdict: VerdictView
    ve_um: float | None
    vce_um: float | None
    held_out_um: float | None
    drift_um_a_night: float | None
    drift_expanded_uncertainty: float | None
    significant: bool
    dated_ahead: list[str]


class PlantView(BaseModel):
    """Machines of one page, those that need attention first. `machine` is the name of the service's own machine, and
    `total` the number of all machines."""

    machine: str
    machines: list[PlantMachine]
    total: int
