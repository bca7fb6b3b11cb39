"""The outbox and the couriers: a restart loses nothing, nothing is repeated without need, nobody is flooded."""

from __future__ import annotations

import errno
import json
import threading
from collections.abc import Sequence
from datetime import UTC, datetime, timedelta
from pathlib import Path
from queue import SimpleQueue

import pytest
from hypothesis import given
from hypothesis import strategies as st
from structlog.testing import capture_logs

from agent.notifications.connection import DeliveryFailed, NoticeRefused
from agent.notifications.dispatcher import FIRST_PAUSE_S, LONGEST_PAUSE_S, Courier, Dispatcher, ReceiverState
from agent.notifications.notice import Notice, Occasion
from agent.notifications.outbox import FILE_NAME, Outbox

PATIENCE_S = 600.0
NOON = datetime(2026, 11, 21, 12, tzinfo=UTC)


def notice(notice_id: str, occasion: Occasion = "end", at: datetime = NOON) -> Notice:
    return Notice(notice_id, at.isoformat(), "mill", occasion, "alarm", "faulted", f"subject of {notice_id}", "text")


class Receiver:
    """Channel that fails as often as `failures` says, then takes notices; `delivered` has their ids."""

    def __init__(self, failures: Sequence[Exception] = (), complaint: str = "") -> None:
        self.failures = list(failures)
        self.complaint = complaint
        self.attempts = 0
        self.delivered: SimpleQueue[str] = SimpleQueue()

    def send(self, told: Notice) -> str:
        self.attempts += 1
        if self.failures:
            raise self.failures.pop(0)
        self.delivered.put(told.notice_id)
        return self.complaint

    def ids(self) -> list[str]:
        return [self.delivered.get_nowait() for _ in range(self.delivered.qsize())]


class Desk:
    """A courier with an outbox, a clock and a calendar of the test."""

    def __init__(self, directory: Path, receiver: Receiver, max_age_hours: float = 72.0) -> None:
        self.now_s, self.today = 1000.0, NOON
        self.states: list[ReceiverState] = []
        self.notes: list[str] = []
        self.outbox = Outbox(directory, ("mail",))
        self.courier = Courier(
            "mail",
            receiver,
            self.outbox,
            max_age_hours,
            self.states.append,
            self.notes.append,
            now=lambda: self.now_s,
            utc_now=lambda: self.today,
        )

    def put(self, told: Notice) -> None:
        self.outbox.put(told, ("mail",))

    def work(self) -> float | None:
        """Attempt until there is a pause or nothing waits."""
        while (wait_s := self.courier.attempt()) == 0.0:
            pass
        return wait_s


def away(count: int) -> list[Exception]:
    return [DeliveryFailed("the receiver cannot be reached", receiver="mail server") for _ in range(count)]


def test_notices_are_delivered_in_their_order_and_once(tmp_path: Path) -> None:
    receiver = Receiver()
    desk = Desk(tmp_path, receiver)
    for number in range(3):
        desk.put(notice(f"n-{number}"))
    assert desk.work() is None
    assert receiver.ids() == ["n-0", "n-1", "n-2"]
    assert desk.states[-1] == ReceiverState("mail", 0)
    assert desk.notes == []


def test_an_id_is_told_once_even_after_a_restart(tmp_path: Path) -> None:
    receiver = Receiver()
    desk = Desk(tmp_path, receiver)
    desk.put(notice("end-1"))
    desk.work()
    again = Desk(tmp_path, receiver)
    again.put(notice("end-1"))
    assert again.work() is None
    assert receiver.ids() == ["end-1"]


def test_a_restart_keeps_what_waits(tmp_path: Path) -> None:
    Desk(tmp_path, Receiver()).put(notice("n-1"))
    receiver = Receiver()
    assert Desk(tmp_path, receiver).work() is None
    assert receiver.ids() == ["n-1"]


def test_the_pauses_grow_and_a_new_notice_does_not_shorten_them(tmp_path: Path) -> None:
    receiver = Receiver(away(9))
    desk = Desk(tmp_path, receiver)
    desk.put(notice("n-1"))
    pauses: list[float] = []
    while (pause_s := desk.work()) is not None:
        pauses.append(pause_s)
        desk.put(notice(f"n-{len(pauses) + 1}"))
        desk.now_s += pause_s - 1.0
        attempts = receiver.attempts
        assert desk.courier.attempt() == pytest.approx(1.0)
        assert receiver.attempts == attempts
        desk.now_s += 1.0
    assert pauses[:3] == [FIRST_PAUSE_S, 2 * FIRST_PAUSE_S, 4 * FIRST_PAUSE_S]
    assert pauses[-1] == LONGEST_PAUSE_S
    assert receiver.ids() == [f"n-{number}" for number in range(1, 11)]


def test_a_failure_is_told_once_and_its_end_once(tmp_path: Path) -> None:
    desk = Desk(tmp_path, Receiver([*away(5)]))
    desk.put(notice("n-1"))
    began = f"{desk.today:%Y-%m-%dT%H:%M:%SZ}"
    with capture_logs() as logs:
        while (pause_s := desk.work()) is not None:
            assert "cannot be reached" in desk.states[-1].problem
            assert (desk.states[-1].waiting, desk.states[-1].since) == (1, began)
            desk.now_s += pause_s
            desk.today += timedelta(seconds=pause_s)
    # the end of the failure is logged as information, which other tests of this process may have switched off
    assert [line["log_level"] for line in logs if line["log_level"] != "info"] == ["warning"]
    assert len(desk.notes) == 2
    assert (desk.states[-1].problem, desk.states[-1].since) == ("", "")


def test_a_notice_that_its_receiver_refuses_does_not_hold_up_the_others(tmp_path: Path) -> None:
    class Picky(Receiver):
        def send(self, told: Notice) -> str:
            if told.notice_id == "big":
                return super().send(told)
            self.delivered.put(told.notice_id)
            return ""

    receiver = Picky([NoticeRefused("the receiver answers 413", receiver="webhook") for _ in range(4)])
    desk = Desk(tmp_path, receiver)
    for one in ("big", "n-1", "n-2"):
        desk.put(notice(one))
    with capture_logs():
        while (pause_s := desk.work()) is not None:
            desk.now_s += pause_s
    assert receiver.ids() == ["n-1", "n-2", "big"]
    assert receiver.attempts == 5


def test_a_defect_in_a_channel_is_a_failure_like_any_other(tmp_path: Path) -> None:
    receiver = Receiver([ZeroDivisionError()])
    desk = Desk(tmp_path, receiver)
    desk.put(notice("n-1"))
    with capture_logs():
        pause_s = desk.work()
    assert desk.states[-1].problem == "defect in the channel: ZeroDivisionError"
    assert pause_s is not None
    desk.now_s += pause_s
    desk.work()
    assert receiver.ids() == ["n-1"]


def test_a_notice_that_is_too_old_is_dropped_with_a_note(tmp_path: Path) -> None:
    receiver = Receiver(away(1))
    desk = Desk(tmp_path, receiver, max_age_hours=24.0)
    desk.put(notice("old"))
    with capture_logs():
        desk.work()
        desk.today += timedelta(hours=24.1)
        desk.put(notice("new", at=desk.today))
        desk.now_s += FIRST_PAUSE_S
        desk.work()
    assert receiver.ids() == ["new"]
    assert any("dropped" in text and "subject of old" in text for text in desk.notes)


def test_the_number_that_waits_is_shown_during_a_pause_and_after_the_last_is_dropped(tmp_path: Path) -> None:
    desk = Desk(tmp_path, Receiver(away(1)), max_age_hours=24.0)
    with capture_logs():
        desk.put(notice("n-1"))
        desk.work()
        desk.put(notice("n-2"))
        desk.work()
        assert desk.states[-1].waiting == 2
        desk.today += timedelta(hours=24.1)
        assert desk.work() is None
    assert desk.states[-1].waiting == 0
    assert "cannot be reached" in desk.states[-1].problem


def test_a_delivery_in_part_is_told_once(tmp_path: Path) -> None:
    desk = Desk(tmp_path, Receiver(complaint="no mail for bob"))
    for number in range(3):
        desk.put(notice(f"n-{number}"))
    with capture_logs():
        assert desk.work() is None
    assert len(desk.notes) == 1
    since = f"{desk.today:%Y-%m-%dT%H:%M:%SZ}"
    assert desk.states[-1] == ReceiverState("mail", 0, "partial", "no mail for bob", since)


def test_a_delivery_in_part_is_neither_a_failure_nor_a_delivery(tmp_path: Path) -> None:
    """Each change between the three states is told, and counts from its own time."""

    class Changing(Receiver):
        def send(self, told: Notice) -> str:
            self.complaint = "" if told.notice_id == "whole" else "no mail for bob"
            if told.notice_id.startswith("fails") and not self.delivered_by_now:
                self.delivered_by_now = True
                raise DeliveryFailed("the receiver cannot be reached", receiver="mail server")
            return self.complaint

        delivered_by_now = False

    desk = Desk(tmp_path, Changing())
    seen: list[tuple[str, bool]] = []
    with capture_logs():
        for number, name in enumerate(("partial-1", "partial-2", "fails-1", "partial-3", "whole")):
            desk.put(notice(name))
            desk.today += timedelta(minutes=number)
            pause_s = desk.work()
            state = desk.states[-1]
            seen.append((state.delivery, state.since == f"{desk.today:%Y-%m-%dT%H:%M:%SZ}"))
            if pause_s is not None:
                assert pause_s == FIRST_PAUSE_S, "a delivery in part is no first failure"
                desk.now_s += pause_s
    assert seen == [
        ("partial", True),
        ("partial", False),
        ("fails", True),
        ("partial", True),
        ("delivers", False),
    ]
    words = [text.removeprefix("notifications: mail ").split(":")[0] for text in desk.notes]
    assert words == [
        "delivers only in part",
        "does not deliver; it is tried again",
        "delivers only in part",
        "delivers again",
    ]


def test_a_full_outbox_drops_the_oldest(tmp_path: Path) -> None:
    outbox = Outbox(tmp_path, ("mail",), most_waiting=3)
    with capture_logs() as logs:
        for number in range(5):
            outbox.put(notice(f"n-{number}"), ("mail",))
    first = outbox.next_for("mail")
    assert first is not None
    assert (outbox.count("mail"), first.notice_id) == (3, "n-2")
    assert [line["notice"] for line in logs] == ["subject of n-0", "subject of n-1"]


def test_only_the_latest_state_waits(tmp_path: Path) -> None:
    outbox = Outbox(tmp_path, ("mqtt",))
    outbox.put(notice("n-1"), ("mqtt",))
    for number in range(5):
        outbox.put(notice(f"s-{number}", "state"), ("mqtt",), replaces=True)
    assert outbox.count("mqtt") == 2
    found = [outbox.next_for("mqtt")]
    assert found[0] is not None
    outbox.remove(found[0], "mqtt")
    found.append(outbox.next_for("mqtt"))
    assert [one.notice_id for one in found if one is not None] == ["n-1", "s-4"]


def test_a_channel_that_is_no_longer_set_is_forgotten(tmp_path: Path) -> None:
    Outbox(tmp_path, ("mail", "mqtt")).put(notice("n-1"), ("mail", "mqtt"))
    assert Outbox(tmp_path, ("mqtt",)).count("mqtt") == 1
    assert Outbox(tmp_path, ("webhook",)).next_for("mail") is None


@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_a_damaged_outbox_is_set_aside(tmp_path_factory: pytest.TempPathFactory, content: bytes) -> None:
    directory = tmp_path_factory.mktemp("outbox")
    (directory / FILE_NAME).write_bytes(content)
    with capture_logs() as logs:
        outbox = Outbox(directory, ("mail",))
    assert outbox.next_for("mail") is None
    assert [line["log_level"] for line in logs] == ["warning"]
    assert (directory / "outbox.damaged").read_bytes() == content
    assert outbox.put(notice("n-1"), ("mail",))


def test_a_damaged_outbox_on_a_disk_that_cannot_be_written_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.EROFS, "read-only file system")

    (tmp_path / FILE_NAME).write_text("damaged")
    monkeypatch.setattr(Path, "replace", refuse)
    with capture_logs() as logs:
        assert Outbox(tmp_path, ("mail",)).put(notice("n-1"), ("mail",))
    assert len(logs) == 2


@pytest.mark.parametrize("key", ["notice_id", "occasion", "alarms", "run"])
def test_an_outbox_of_another_form_is_set_aside(tmp_path: Path, key: str) -> None:
    assert_set_aside(tmp_path, key, {"not": "this"})


@pytest.mark.parametrize("at", ["2026-11-29T03:15:00", "yesterday"])
def test_a_notice_of_no_known_instant_is_set_aside(tmp_path: Path, at: str) -> None:
    assert_set_aside(tmp_path, "at", at)


def assert_set_aside(tmp_path: Path, key: str, value: object) -> None:
    Outbox(tmp_path, ("mail",)).put(notice("n-1"), ("mail",))
    path = tmp_path / FILE_NAME
    document = json.loads(path.read_text())
    document["waiting"][0]["notice"][key] = value
    path.write_text(json.dumps(document))
    with capture_logs():
        assert Outbox(tmp_path, ("mail",)).next_for("mail") is None


def test_an_outbox_that_cannot_be_written_works_on_and_says_so_once(tmp_path: Path) -> None:
    (tmp_path / "notifications").write_text("a file in the way")
    with capture_logs() as logs:
        outbox = Outbox(tmp_path / "notifications", ("mail",))
        for number in range(3):
            assert outbox.put(notice(f"n-{number}"), ("mail",))
    assert outbox.count("mail") == 3
    assert [line["log_level"] for line in logs] == ["warning"]


# ---------------------------------------------------------------------- threads


def dispatched(directory: Path, receivers: dict[str, Receiver]) -> Dispatcher:
    outbox = Outbox(directory, receivers)

    def courier(name: str) -> Courier:
        return Courier(name, receivers[name], outbox, 72.0, lambda _: None, lambda _: None, utc_now=lambda: NOON)

    return Dispatcher(outbox, {name: courier(name) for name in receivers})


class Stuck(Receiver):
    """Channel whose delivery does not end before the test ends it."""

    def __init__(self) -> None:
        super().__init__()
        self.began, self.may_end = threading.Event(), threading.Event()

    def send(self, told: Notice) -> str:
        self.began.set()
        assert self.may_end.wait(PATIENCE_S)
        return super().send(told)


def test_a_stuck_receiver_delays_neither_the_others_nor_the_caller_nor_the_end(tmp_path: Path) -> None:
    stuck, good = Stuck(), Receiver()
    dispatcher = dispatched(tmp_path, {"mqtt": stuck, "mail": good})
    dispatcher.start()
    dispatcher.put(notice("n-1"), ("mqtt", "mail"))
    assert stuck.began.wait(PATIENCE_S)
    dispatcher.put(notice("n-2"), ("mqtt", "mail"))
    assert [good.delivered.get(timeout=PATIENCE_S) for _ in range(2)] == ["n-1", "n-2"]
    assert not dispatcher.close(0.0)
    after = Outbox(tmp_path, ("mqtt", "mail"))
    assert after.count("mqtt") == 2  # delivered, perhaps again, after the next start
    stuck.may_end.set()
    assert dispatcher.close(PATIENCE_S)


def test_the_end_delivers_what_can_be_delivered_at_once_and_waits_for_no_pause(tmp_path: Path) -> None:
    failing, good = Receiver(away(1)), Receiver()
    dispatcher = dispatched(tmp_path, {"mqtt": failing, "mail": good})
    with capture_logs():
        dispatcher.put(notice("n-1"), ("mqtt", "mail"))
        dispatcher.start()
        assert dispatcher.close(PATIENCE_S)
    assert good.ids() == ["n-1"]
    assert (failing.attempts, failing.ids()) == (1, [])
    assert Outbox(tmp_path, ("mqtt",)).count("mqtt") == 1


def test_a_notice_for_nobody_is_not_kept(tmp_path: Path) -> None:
    dispatcher = dispatched(tmp_path, {"mail": Receiver()})
    dispatcher.put(notice("n-1"), ())
    assert not (tmp_path / FILE_NAME).exists()
