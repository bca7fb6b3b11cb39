"""Pairing codes in virtual time, and the paired clients in their file."""

from __future__ import annotations

import json
from itertools import count
from pathlib import Path
from typing import Any

import pytest

from agent.cli.service_commands.pair import pair_command
from agent.service.access.access import Access
from agent.service.access.page_address import page_address
from agent.service.access.paired_clients import FILE_NAME, MAX_CLIENTS, PairedClients
from agent.service.access.pairing_codes import (
    MAX_MINUTES,
    MAX_TRIES_PER_MINUTE,
    MAX_WRONG_TRIES,
    Invitation,
    PairingCodes,
    TooManyTries,
    WrongCode,
    six_digits,
)
from agent.service.access.roles import LEAST_ROLE, MACHINE, ROLES, Requester
from agent.settings.service import ServiceSettings
from drivers.clock import VirtualClock
from drivers.errors import ConfigurationError, UserError

PHONE = Invitation("operator", "phone")
WRONG = "999999"
TLS = {"certificate_file": Path("cert.pem"), "key_file": Path("key.pem")}


def as_it_is(invitation: Invitation) -> Invitation:
    return invitation


def codes(clock: VirtualClock) -> PairingCodes:
    numbers = count(100_000)
    return PairingCodes(clock.now, lambda: str(next(numbers)))


def test_a_code_is_good_once_and_for_its_minutes() -> None:
    clock = VirtualClock()
    pairing = codes(clock)
    first = pairing.open(PHONE, minutes=2.0)
    clock.sleep(119.0)
    assert pairing.use(first, as_it_is) == PHONE
    with pytest.raises(WrongCode):
        pairing.use(first, as_it_is)
    second = pairing.open(PHONE, minutes=2.0)
    clock.sleep(120.0)
    with pytest.raises(WrongCode, match=r"no longer valid.*volcal pair"):
        pairing.use(second, as_it_is)
    third, fourth = pairing.open(PHONE, 2.0), pairing.open(PHONE, 2.0)
    with pytest.raises(WrongCode):
        pairing.use(third, as_it_is)  # the newer one has replaced it
    assert pairing.use(fourth, as_it_is) == PHONE


def test_a_code_is_void_after_five_wrong_tries() -> None:
    clock = VirtualClock()
    pairing = codes(clock)
    code = pairing.open(PHONE, 5.0)
    for _ in range(MAX_WRONG_TRIES - 1):
        with pytest.raises(WrongCode):
            pairing.use(WRONG, as_it_is)
    assert pairing.use(code, as_it_is) == PHONE
    code = pairing.open(PHONE, 5.0)
    for _ in range(MAX_WRONG_TRIES):
        with pytest.raises(WrongCode):
            pairing.use(WRONG, as_it_is)
    with pytest.raises(TooManyTries):
        pairing.use(code, as_it_is)
    clock.sleep(60.0)
    with pytest.raises(WrongCode):
        pairing.use(code, as_it_is)


def test_tries_are_bounded_over_all_codes_and_a_refused_one_is_not_judged() -> None:
    clock = VirtualClock()
    pairing = codes(clock)
    for _ in range(MAX_TRIES_PER_MINUTE):
        with pytest.raises(WrongCode):
            pairing.use(WRONG, as_it_is)  # also while there is no code
    code = pairing.open(PHONE, 5.0)
    clock.sleep(20.0)
    with pytest.raises(TooManyTries) as refused:
        pairing.use(code, as_it_is)
    assert refused.value.wait_s == 40.0
    clock.sleep(refused.value.wait_s)
    assert pairing.use(code, as_it_is) == PHONE


def test_codes_have_six_digits_and_differ() -> None:
    drawn = {six_digits() for _ in range(200)}
    assert all(len(code) == 6 and code.isascii() and code.isdigit() for code in drawn)
    assert len(drawn) > 190


def test_clients_are_kept_for_their_owner_alone_and_without_their_tokens(tmp_path: Path) -> None:
    access = Access(
        "the machine's token", PairedClients(tmp_path, lambda: "2026-11-29T03:00:00Z"), codes(VirtualClock())
    )
    code, invitation = access.invite("operator", None, 5.0)
    assert invitation.name == "operator 1"
    phone = access.pair(code)
    panel = access.pair(access.invite("engineer", "Büro 2", 5.0)[0])
    path = tmp_path / FILE_NAME
    assert path.stat().st_mode & 0o777 == 0o600
    stored = path.read_text(encoding="utf-8")
    assert phone.token not in stored
    assert panel.token not in stored

    # after a restart
    again = Access("the machine's token", PairedClients(tmp_path), codes(VirtualClock()))
    assert again.requester(phone.token) == Requester("operator", "operator 1")
    assert again.requester(panel.token) == Requester("engineer", "Büro 2")
    assert again.requester("the machine's token") == MACHINE
    assert again.requester("the machine's Token") is None
    assert again.requester("") is None
    first = again.clients.all[0]
    assert (first.name, first.paired) == ("operator 1", "2026-11-29T03:00:00Z")
    assert again.invite("operator", None, 5.0)[1].name == "operator 2"

    again.revoke("operator 1")
    assert again.requester(phone.token) is None
    assert PairedClients(tmp_path).requester(phone.token) is None
    with pytest.raises(UserError, match="no client is paired as operator 1"):
        again.revoke("operator 1")
    assert again.requester(panel.token) is not None


def test_a_code_is_not_used_up_by_a_client_that_cannot_be_kept(tmp_path: Path) -> None:
    access = Access("the machine's token", PairedClients(tmp_path), codes(VirtualClock()))
    code, _ = access.invite("operator", "phone", 5.0)
    path = tmp_path / FILE_NAME
    path.mkdir()
    with pytest.raises(ConfigurationError, match="cannot be kept"):
        access.pair(code)
    path.rmdir()
    assert access.pair(code).requester == Requester("operator", "phone")
    with pytest.raises(WrongCode):
        access.pair(code)


def test_the_command_knows_the_roles_and_the_longest_validity_of_the_service() -> None:
    options: dict[str | None, Any] = {option.name: option.type for option in pair_command.params}
    assert list(options["role"].choices) == list(ROLES)
    assert options["minutes"].max == MAX_MINUTES


@pytest.mark.parametrize("name", ["", "   ", "x" * 41, "Büro 2"])
def test_a_name_is_shown_so_it_is_short_and_unique(tmp_path: Path, name: str) -> None:
    clients = PairedClients(tmp_path)
    clients.add("Büro 2", "operator")
    with pytest.raises(UserError):
        clients.free_name(name, "operator")


def test_names_are_printable_and_their_number_is_bounded(tmp_path: Path) -> None:
    clients = PairedClients(tmp_path)
    assert clients.free_name("a\x1b[2Jb\n c", "operator") == "a\N{REPLACEMENT CHARACTER}[2Jb c"
    entry = {"role": "operator", "paired": "2026-11-29T03:00:00Z", "sha256": "0" * 64}
    many = [{"name": f"panel {number}", **entry} for number in range(MAX_CLIENTS)]
    path = tmp_path / FILE_NAME
    path.write_text(json.dumps({"clients": many}))
    path.chmod(0o600)
    with pytest.raises(UserError, match="revoke one"):
        PairedClients(tmp_path).add("one more", "operator")


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "{}",
        '{"clients": [1]}',
        '{"clients": [{"name": "a"}]}',
        '{"clients": [{"name": "a", "role": "king", "paired": "x", "sha256": "y"}]}',
        '{"clients": [{"name": "a", "role": "operator", "paired": "2026-11-29T03:00:00Z", "sha256": "\u00e9"}]}',
        '{"clients": [{"name": 1, "role": "operator", "paired": "x", "sha256": "y"}]}',
        "\udc80",
        "[" * 100_000,
    ],
)
def test_a_damaged_file_is_refused_in_words(tmp_path: Path, text: str) -> None:
    path = tmp_path / FILE_NAME
    path.write_bytes(text.encode(errors="surrogateescape"))
    path.chmod(0o600)
    with pytest.raises(ConfigurationError, match=r"is damaged.*pair every client again"):
        PairedClients(tmp_path)


def test_a_file_that_others_can_read_is_refused_and_one_that_cannot_be_written_changes_nothing(tmp_path: Path) -> None:
    clients = PairedClients(tmp_path)
    token = clients.add("panel", "operator")
    path = tmp_path / FILE_NAME
    path.chmod(0o644)
    with pytest.raises(ConfigurationError, match="chmod 600"):
        PairedClients(tmp_path)
    path.unlink()
    path.mkdir()
    with pytest.raises(ConfigurationError, match="cannot be kept"):
        clients.revoke("panel")
    assert clients.requester(token) is not None


def test_an_engineer_may_do_what_an_operator_may() -> None:
    operator, engineer = Requester("operator", "a"), Requester("engineer", "b")
    assert operator.may < engineer.may == MACHINE.may == set(LEAST_ROLE)
    assert {"start", "hold", "resume", "reset", "give_up"} <= operator.may
    assert not {"restore_table", "check_settings", "diagnostics"} & operator.may


@pytest.mark.parametrize(
    ("service", "url", "address"),
    [
        ({}, "http://127.0.0.1:8517", "http://127.0.0.1:8517"),
        ({"host_names": ["mill-7.local"]}, "http://127.0.0.1:8517", "http://127.0.0.1:8517"),
        ({"host": "10.0.0.5", "host_names": ["mill-7", "b"], **TLS}, "https://10.0.0.5", "https://mill-7"),
        ({"host": "::", "host_names": ["fd00::2"], **TLS}, "https://[::1]:8517", "https://[fd00::2]:8517"),
        ({"host": "192.0.2.2", **TLS}, "https://192.0.2.2:8517", "https://192.0.2.2:8517"),
    ],
)
def test_the_address_of_the_page_is_one_that_the_client_can_reach(
    service: dict[str, Any], url: str, address: str
) -> None:
    assert page_address(ServiceSettings(**service), url, "123456") == f"{address}/#pair=123456"
