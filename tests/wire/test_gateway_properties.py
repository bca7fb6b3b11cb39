"""Property tests of the gateway: no number gives two commands, and no command comes without its code, whatever is
written.
"""

from __future__ import annotations

import itertools
import tempfile
from pathlib import Path

from fake_control import FakeControl
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, rule

from agent.execution.states import RunState
from agent.service.gateway.access import AccessCode
from agent.service.gateway.command_block import FIRST, SIZE
from agent.service.gateway.command_handler import CommandHandler
from agent.service.gateway.frames import answer_request
from agent.service.gateway.gateway import Gateway, GatewayFacts, status_image
from agent.service.gateway.heartbeat import Heartbeats
from agent.service.gateway.register_codec import number_words, plain_text, text_words, whole_number
from agent.service.gateway.registers import BLOCKS, COMMAND, PACKML_NUMBERS, STATE_NUMBERS, STATUS, Form
from agent.service.gateway.sequence_ledger import SequenceLedger, next_sequence
from agent.service.gateway.session import PanelSession

CODE = 77
FREE = {"hold", "abort"}


def gateway_over(control: FakeControl, directory: Path) -> Gateway:
    access = AccessCode(CODE)
    return Gateway(control, CommandHandler(control, SequenceLedger(directory), access), access, Heartbeats(5), "note")


@given(st.lists(st.binary(min_size=1, max_size=80), max_size=20))
def test_random_requests_are_answered_and_move_nothing_without_the_code(requests):
    with tempfile.TemporaryDirectory() as directory:
        control = FakeControl()
        session = PanelSession(gateway_over(control, Path(directory)))
        for request in requests:
            answer = answer_request(request, session)
            assert answer[0] & 0x7F == request[0] & 0x7F
            assert len(answer) <= 253
        assert {name for name, _ in control.asked} <= FREE


class Panels(RuleBasedStateMachine):
    """Two panel connections that draft, commit, repeat and reconnect, and a service that restarts now and then.

    The model follows the document: one draft per connection, one accepted number, one command per number.
    """

    @initialize()
    def begin(self) -> None:
        self.directory = tempfile.TemporaryDirectory()
        self.control = FakeControl()
        self.given: list[int] = []
        self.restart()

    def teardown(self) -> None:
        self.directory.cleanup()

    @rule()
    def restart(self) -> None:
        self.gateway = gateway_over(self.control, Path(self.directory.name))
        self.sessions = [PanelSession(self.gateway), PanelSession(self.gateway)]
        self.drafts = [[0] * SIZE, [0] * SIZE]
        self.last: list[int] | None = None

    @rule(who=st.integers(0, 1))
    def reconnect(self, who: int) -> None:
        self.sessions[who] = PanelSession(self.gateway)
        self.drafts[who] = [0] * SIZE

    @rule(who=st.integers(0, 1), offset=st.integers(0, SIZE - 2), data=st.data())
    def draft(self, who: int, offset: int, data: st.DataObject) -> None:
        words = data.draw(st.lists(st.integers(0, 3), min_size=1, max_size=min(SIZE - 1 - offset, 12)))
        self.write(who, offset, words)
        self.drafts[who][offset : offset + len(words)] = words

    @rule(
        who=st.integers(0, 1),
        command=st.integers(0, 8),
        code=st.sampled_from([CODE, CODE, 5]),
        ahead=st.sampled_from([1, 1, 1, 0, 2, 65535]),
    )
    def commit(self, who: int, command: int, code: int, ahead: int) -> None:
        accepted = self.accepted()
        sequence = accepted
        for _ in range(ahead if ahead < 3 else 0):
            sequence = next_sequence(sequence)
        words = [*self.drafts[who]]
        words[0], words[1], words[2], words[25], words[26], words[27] = command, 1, 1, 0, code, sequence
        before = len(self.control.asked)
        answer = self.write(who, 0, words)
        self.drafts[who] = [0] * SIZE
        asked = self.control.asked[before:]
        if ahead == 1:
            assert answer[0] == 16
            self.given.append(sequence)
            self.last = words
            assert len(asked) <= 1
            if code != CODE:
                assert {name for name, _ in asked} <= FREE
        else:
            assert asked == []

    @rule(who=st.integers(0, 1))
    def write_the_same_again(self, who: int) -> None:
        """Write the block again, like a PLC that writes in every cycle."""
        if self.last is not None:
            before = len(self.control.asked)
            assert self.write(who, 0, self.last)[0] == 16
            self.drafts[who] = [0] * SIZE
            assert len(self.control.asked) == before

    @rule()
    def a_second_goes_by(self) -> None:
        self.gateway.tick()

    @rule()
    def the_run_ends(self) -> None:
        self.control.now(RunState.COMPLETE)

    @invariant()
    def drafts_are_their_connections_own(self) -> None:
        for session, draft in zip(self.sessions, self.drafts, strict=True):
            shown = [0 if place in (25, 26) else word for place, word in enumerate(draft)]
            assert list(session.read(FIRST, SIZE)) == shown

    @invariant()
    def the_last_number_given_is_the_accepted_one(self) -> None:
        if self.given:
            assert self.accepted() == self.given[-1]
            assert 1 <= self.accepted() <= 0xFFFF
            assert len(set(self.given)) == len(self.given)

    def accepted(self) -> int:
        return self.gateway.image()[28]

    def write(self, who: int, offset: int, words: list[int]) -> bytes:
        head = bytes((16, *(FIRST + offset).to_bytes(2), *len(words).to_bytes(2), 2 * len(words)))
        return answer_request(head + b"".join(word.to_bytes(2) for word in words), self.sessions[who])


TestPanels = Panels.TestCase
TestPanels.settings = settings(max_examples=60, stateful_step_count=25)


def test_the_map_has_no_holes_and_no_overlaps():
    for block in BLOCKS:
        for one, following in itertools.pairwise(block):
            assert one.end == following.address
    assert STATUS[-1].end <= COMMAND[0].address
    first_read = next(register for register in STATUS if register.name == "question_text").address
    assert first_read <= 125, "everything but the question in one request"
    assert len(status_image(FakeControl().status(), GatewayFacts())) == STATUS[-1].end


def test_every_state_has_its_numbers():
    assert set(STATE_NUMBERS) == set(RunState)
    assert len(set(STATE_NUMBERS.values())) == len(RunState)
    for state in RunState:
        control = FakeControl()
        control.now(state)
        image = status_image(control.status(), GatewayFacts())
        assert image[3] == STATE_NUMBERS[state]
        assert image[4] == PACKML_NUMBERS[control.status().packml] > 0


@given(value=st.floats(), form=st.sampled_from([Form.U16, Form.U32, Form.I32]))
def test_numbers_come_back_within_their_form(value, form):
    register = next(register for register in STATUS if register.form is form)
    words = number_words(register, value)
    assert len(words) == register.words
    raw = whole_number(words)
    whole = raw - 2**32 if form is Form.I32 and raw >= 2**31 else raw
    low, high = {Form.U16: (0, 65535), Form.U32: (0, 2**32 - 1), Form.I32: (-(2**31), 2**31 - 1)}[form]
    if low <= value <= high:
        assert abs(whole - value) <= 0.5


@given(st.text(max_size=60))
def test_any_text_becomes_ascii_of_the_right_length(text):
    register = next(register for register in STATUS if register.name == "doing")
    words = text_words(register, text)
    assert len(words) == register.words
    assert all(byte < 0x80 for word in words for byte in word.to_bytes(2))


@given(st.text(st.characters(min_codepoint=0x21, max_codepoint=0x7E), max_size=32))
def test_ascii_comes_back_as_it_was(text):
    register = next(register for register in STATUS if register.name == "position_set")
    assert plain_text(text_words(register, text)) == text
