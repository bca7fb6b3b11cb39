"""Most helpful action against values that reach their tolerances: a mechanical one, or a new calibration."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agent.files import present_file
from agent.history.schema import StoredRun
from agent.history.series import ACTIVE, BARE, HELD_OUT
from agent.history.trends import Trend, TrendAlarm
from agent.workpiece.estimate_and_table import ESTIMATE_NAME
from agent.workpiece.proposed_actions import ProposedActions, propose_actions
from drivers.errors import InputError
from twin.workpiece.mechanical_actions import MOST_ACTIONS

_ERROR = re.compile(r"(?P<error>E[XYZABC][XYZ]|[ABC]0[XYZ])(\[(?P<order>\d+)\])?")
_SQUARE_AXES = {"A": {"Y", "Z"}, "B": {"X", "Z"}, "C": {"X", "Y"}}
"""Axes that a squareness error about A, B or C turns towards each other."""
_ROLLS = {"EAX", "EBY", "ECZ"}
_HIGHEST_OF_SHIMS = 4
"""Highest order of a Legendre series that shims at both ends of a guide and at three places between change much."""


@dataclass(frozen=True)
class HelpfulAction:
    """Most helpful action, or the reason why there is none, in words (`text`).

    `action` is the proposed mechanical action as in the JSON object of `volcal actions`; it is None if there is none.
    `run_id` is the run whose estimate proposes it, and `ve_um` the volumetric error without a table in µm, before and
    after this action; the actions that help more are carried out before.
    """

    text: str
    action: Mapping[str, Any] | None = None
    run_id: str | None = None
    ve_um: tuple[float, float] | None = None

    def as_json(self) -> dict[str, Any]:
        """Return the action as a mapping to be written as JSON (docs/reference/json.md)."""
        before, after = self.ve_um or (None, None)
        return {
            "text": self.text,
            "run": self.run_id,
            "ve_before_um": before,
            "ve_after_um": after,
            "action": None if self.action is None else dict(self.action),
        }


def helpful_actions(
    trends: Sequence[Trend], runs: Sequence[StoredRun], state_directory: Path, machine: Path | None = None
) -> Mapping[str, HelpfulAction]:
    """Return what would help most against each of the `trends` that has reached its tolerance or soon will, by the name
    of the series.

    Mechanical actions are those of the latest of the `runs`, oldest first, whose folder in `state_directory` has an
    estimate. `machine` is the machine file that states guides and feet, None without one.
    """
    grave = [trend for trend in trends if any(alarm.kind.of_tolerance for alarm in trend.alarms)]
    names = [trend.series.name for trend in grave]
    found = {name: HelpfulAction("calibrate anew: the table no longer fits the machine") for name in names}
    mechanical = [trend for trend in grave if trend.series.name not in (ACTIVE, HELD_OUT)]
    if mechanical:
        run_id, plan = _latest_plan(runs, state_directory, machine)
        for trend in mechanical:
            name, title = trend.series.name, trend.series.title
            found[name] = plan if isinstance(plan, HelpfulAction) else _chosen(name, title, run_id, plan)
    return found


def sources_key(state_directory: Path, machine: Path | None = None) -> tuple[tuple[str, int, int], ...]:
    """Return what stands for the files from which actions are proposed: path, time of change in ns and size in bytes of
    every estimate in the folders of `state_directory`, and of the `machine` file. Files that cannot be read are left
    out."""
    try:
        with os.scandir(state_directory) as entries:
            folders = sorted(entry.path for entry in entries if entry.is_dir())
    except OSError:
        folders = []
    files = [present_file(Path(folder) / ESTIMATE_NAME) for folder in folders]
    found = []
    for file in files if machine is None else (*files, machine):
        with suppress(OSError):
            state = file.stat()
            found.append((str(file), state.st_mtime_ns, state.st_size))
    return tuple(found)


def alarms_json(alarms: Sequence[TrendAlarm], actions: Mapping[str, HelpfulAction]) -> list[dict[str, Any]]:
    """Return the alarms to be written as JSON. The hint of an alarm about a tolerance is what helps most."""
    return [
        {"series": one.series, "kind": one.kind.value, "text": one.text, "hint": hint_of(one, actions)}
        for one in alarms
    ]


def hint_of(alarm: TrendAlarm, actions: Mapping[str, HelpfulAction]) -> str:
    """Return what helps most against the cause of an alarm, an empty text for one that is not about a tolerance."""
    action = actions.get(alarm.series) if alarm.kind.of_tolerance else None
    return "" if action is None else action.text


def _latest_plan(
    runs: Sequence[StoredRun], state_directory: Path, machine: Path | None
) -> tuple[str, ProposedActions | HelpfulAction]:
    """Return the run that has the latest estimate, and the actions that it proposes or why there are none."""
    for run in reversed(runs):
        folder = state_directory / run.run_id
        if run.parameters and present_file(folder / ESTIMATE_NAME).exists():
            try:
                return run.run_id, propose_actions(folder, MOST_ACTIONS, None, machine)
            except InputError as error:
                return run.run_id, HelpfulAction(f"no mechanical action can be proposed: {error.message}")
    return "", HelpfulAction("no mechanical action can be proposed: no run with an estimate is in the state directory")


def _chosen(name: str, title: str, run_id: str, proposed: ProposedActions) -> HelpfulAction:
    """Return the first of the proposed actions, which are in the order of their gain, that changes the series."""
    document = proposed.as_json()
    states = [document["ve_before"], *(action["ve_after"] for action in document["actions"])]
    for before, action in zip(states, document["actions"], strict=False):
        if name == BARE or changes_error(action, name):
            ve_um = (float(before["expected_um"]), float(action["ve_after"]["expected_um"]))
            text = f"what helps most: {action['text']} (VE without table {ve_um[0]:.1f} to {ve_um[1]:.1f} µm)"
            return HelpfulAction(text, action, run_id, ve_um)
    if not document["actions"]:
        return HelpfulAction("no mechanical action is larger than its uncertainty", None, run_id)
    return HelpfulAction(f"none of the proposed mechanical actions changes {title}", None, run_id)


def changes_error(action: Mapping[str, Any], name: str) -> bool:
    """Return True if a mechanical action, as in the JSON object of `volcal actions`, changes the geometric error or the
    coefficient `name`.

    A scale changes the linear error of its axis (EXX, and its slope EXX[1]), a turned guide the squareness of its two
    axes. A shimmed guide changes its straightness and the angle by which the carriage tilts, up to the orders that a
    rail with three shims between its ends shows. A levelled guide changes its roll, by a straight line.
    """
    found = _ERROR.fullmatch(name)
    if found is None:
        return False
    kind, axis, towards = action["kind"], action["axis"], action["towards"]
    error, order = found["error"], found["order"]
    if kind == "scale":
        return error == f"E{axis}{axis}" and order in (None, "1")
    if kind == "squareness":
        return error[1] == "0" and {axis, towards} == _SQUARE_AXES[error[0]]
    if kind == "straightness":
        # by the cross product of the axis and the direction of the shims, the third axis
        tilt = "ABC"["XYZ".index(({"X", "Y", "Z"} - {axis, towards}).pop())]
        lowest = {f"E{towards}{axis}": 2, f"E{tilt}{axis}": 1}.get(error)
        return lowest is not None and (order is None or lowest <= int(order) <= _HIGHEST_OF_SHIMS)
    return kind == "level" and error in _ROLLS and error[2] == axis and order in (None, "1")
