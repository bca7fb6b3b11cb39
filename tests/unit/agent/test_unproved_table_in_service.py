"""The service says that an unproved table is active, in the words of the command line, and offers the ways out."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest
from service_house import House, house

from agent.errors import NotAllowedInState, PlanRefused
from agent.execution.states import RunState
from agent.runs.reconcile_result import CompensationState, ReconcileAction, Reconciliation
from agent.runs.run_request import RunRequest
from agent.runs.unfinished_run import UnfinishedRun
from agent.runs.unproved_table import UnprovedTable
from agent.service.gateway.gateway import GatewayFacts, _gateway_values
from agent.service.gateway.registers import FLAGS
from agent.service.http.models import status_view
from agent.service.opcua.model import VARIABLES
from drivers.errors import LinkLost, StoreError

ASSETS = Path(__file__).parents[3] / "agent" / "service" / "page" / "assets"
TABLE = UnprovedTable("20261128T010000Z-abcd", 2, 1, provable=True)
LEFT = Reconciliation(
    CompensationState.UNPROVED, ReconcileAction.LEFT, 2, None, None, TABLE.way_out, TABLE, "bank locked"
)
RESTORED = Reconciliation(CompensationState.UNPROVED, ReconcileAction.RESTORED, 1)


def left(built: House) -> None:
    """Bring the service to the state after the reset of a run whose table could not be taken back."""
    built.machine.found.append(LEFT)
    built.owner.reset()


def test_status_says_which_table_is_active_and_offers_the_ways_out(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        left(built)
        status = built.owner.status()
        assert status.state is RunState.IDLE
        assert (status.unproved, status.active_bank) == (TABLE, 2)
        assert status.doing == "not ready: unproved table active (bank 2)"
        assert status.may == {"restore_former", "give_up", "reset"}
        (alarm,) = status.alarms
        assert alarm.text == f"{TABLE.situation}: bank locked"
        assert alarm.hint == TABLE.way_out


def test_a_table_that_is_active_is_not_called_inactive(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        left(built)
        built.parts.board.enter(RunState.WRITTEN, "found at the start")
        assert built.owner.status().doing == "not ready: unproved table active (bank 2)"


def test_every_endpoint_says_the_same(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        left(built)
        status = built.owner.status()
        view = status_view(status, 0).unproved
        assert view is not None
        assert (view.situation, view.way_out, view.provable) == (TABLE.situation, TABLE.way_out, True)
        (variable,) = [one for one in VARIABLES if one.path == "Monitoring/UnprovedTable"]
        assert variable.of(status) == f"{TABLE.situation}; {TABLE.way_out}"
        flags = _gateway_values(status, GatewayFacts())["flags"]
        assert isinstance(flags, int) and flags & 1 << FLAGS.index("unproved_table")
        messages = json.loads((ASSETS / "messages.json").read_text(encoding="utf-8"))
        english = messages["unproved.situation"]["en"].format(bank=TABLE.bank, run=TABLE.run_id)
        assert english.lower() == f"{TABLE.situation}.".lower()


def test_a_restore_is_tried_until_the_controller_carries_it_out(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        left(built)
        built.machine.found.extend([LEFT, LEFT, RESTORED])
        for _ in range(2):
            with pytest.raises(StoreError, match="bank locked") as refused:
                built.owner.restore_former()
            assert refused.value.hint == TABLE.way_out
            assert len(built.owner.status().alarms) == 1
        built.owner.restore_former()
        status = built.owner.status()
        assert (status.unproved, status.active_bank, status.alarms) == (None, 1, ())
        assert status.doing == "ready to start"
        with pytest.raises(NotAllowedInState):
            built.owner.restore_former()


def test_a_reset_tries_to_restore_again(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        left(built)
        left(built)
        assert len(built.owner.status().alarms) == 1
        built.machine.found.append(RESTORED)
        built.owner.reset()
        assert built.owner.status().unproved is None
        assert built.owner.status().alarms == ()


def test_no_run_starts_while_the_controller_keeps_the_unproved_table(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        left(built)
        built.machine.found.append(LEFT)
        with pytest.raises(PlanRefused, match="bank 2 is active") as refused:
            built.owner.start(RunRequest(kind="calibrate", source="page", consent=True))
        assert TABLE.way_out in refused.value.hint
        assert (built.owner.busy, built.owner.status().state) == (False, RunState.IDLE)


def test_giving_up_is_carried_out_or_says_what_to_do_at_the_controller(tmp_path: Path) -> None:
    ended = UnprovedTable(TABLE.run_id, 2, 1, provable=False)
    given_up = Reconciliation(
        CompensationState.UNPROVED, ReconcileAction.LEFT, 2, None, None, ended.way_out, ended, "bank locked"
    )
    with house(tmp_path) as built:
        left(built)
        built.machine.found.extend([given_up, RESTORED])
        with pytest.raises(StoreError, match="bank 2 is active") as refused:
            built.owner.give_up()
        assert "activate bank 1 at the controller" in refused.value.hint
        assert built.owner.status().unproved == ended
        built.owner.give_up()
        assert built.owner.status().unproved is None


UNFINISHED = UnfinishedRun(
    1, "20261128T020000Z-cdef", "calibrate", "2026-11-28T02:00:00Z", RunState.MEASURING, "", 27, "move", ""
)
AS_IT_WAS = Reconciliation(CompensationState.AS_EXPECTED, ReconcileAction.NOTHING, 1)


def test_an_unfinished_run_can_be_given_up(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        built.machine.found.extend([replace(AS_IT_WAS, unfinished=UNFINISHED), AS_IT_WAS])
        built.owner.reconcile_if_reached()
        before = built.owner.status()
        assert (before.unfinished, before.may >= {"resume_run", "give_up", "start"}) == (UNFINISHED.run_id, True)
        built.owner.give_up("panel 2")
        assert "asked by panel 2" in built.machine.asked
        after = built.owner.status()
        assert after.unfinished is None
        assert not after.may & {"resume_run", "give_up"}


def test_an_earlier_unfinished_run_is_offered_once_the_later_one_is_given_up(tmp_path: Path) -> None:
    earlier = replace(UNFINISHED, run_id="20261128T013000Z-ab12")
    with house(tmp_path) as built:
        built.machine.found.extend([replace(AS_IT_WAS, unfinished=one) for one in (UNFINISHED, earlier)])
        built.owner.reconcile_if_reached()
        built.owner.give_up()
        assert built.owner.status().unfinished == earlier.run_id


def test_a_run_that_cannot_be_ended_stays_unfinished(tmp_path: Path) -> None:
    left_alone = Reconciliation(
        CompensationState.CHANGED, ReconcileAction.LEFT, 1, None, UNFINISHED, "look at the controller"
    )
    with house(tmp_path) as built:
        built.machine.found.extend([replace(AS_IT_WAS, unfinished=UNFINISHED), left_alone])
        built.owner.reconcile_if_reached()
        with pytest.raises(StoreError, match="the run is still unfinished") as refused:
            built.owner.give_up()
        assert refused.value.hint == "look at the controller"
        assert built.owner.status().unfinished == UNFINISHED.run_id


def test_there_is_nothing_to_give_up(tmp_path: Path) -> None:
    with house(tmp_path) as built, pytest.raises(NotAllowedInState, match="while it is unfinished"):
        built.owner.give_up()


def test_a_machine_that_is_away_changes_nothing(tmp_path: Path) -> None:
    with house(tmp_path) as built:
        left(built)
        built.machine.away.append(LinkLost("connection refused"))
        with pytest.raises(LinkLost):
            built.owner.restore_former()
        assert built.owner.status().unproved == TABLE
