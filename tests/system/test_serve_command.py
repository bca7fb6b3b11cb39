"""The night service as a whole: real processes, real sockets, the simulator's clock in step with the service."""

from __future__ import annotations

import json
import os
import signal
import socket
import tomllib
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding, NoEncryption, PrivateFormat
from cryptography.x509.oid import NameOID
from service_process import AT_ONCE, Service, service, short_settings, simulator, systemd_socket
from simulated import PATIENCE_S, wait_for
from stored_run import stored_run

from agent.execution.states import FINAL

ENDS = {state.value for state in FINAL}


@pytest.fixture(scope="module")
def house(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Service]:
    """One service for those who leave it as they found it: idle."""
    directory = tmp_path_factory.mktemp("house")
    with simulator(directory) as (_, ready), service(short_settings(ready, directory)) as running:
        yield running


@pytest.fixture
def served(house: Service) -> Iterator[Service]:
    yield house
    house.post("/api/abort")
    house.reached("idle", "complete", "refused", "aborted", "faulted")
    house.post("/api/reset")


def streamed(running: Service, headers: dict[str, str]) -> list[tuple[str, str, dict]]:
    """(id, kind, document) of server-sent events up to the end of the run."""
    found: list[tuple[str, str, dict]] = []
    with running.client() as client, client.stream("GET", "/api/events", headers=headers) as answer:
        assert answer.headers["content-type"].startswith("text/event-stream")
        fields: dict[str, str] = {}
        for line in answer.iter_lines():
            if line:
                name, _, value = line.partition(": ")
                fields[name] = value
            elif "data" in fields:
                found.append((fields.get("id", ""), fields["event"], json.loads(fields["data"])))
                fields = {}
                if found[-1][1] == "state" and found[-1][2]["data"]["state"] in ENDS:
                    return found
    raise AssertionError("the stream ended before the run")


def test_a_whole_run_with_its_events_and_what_the_journal_tells_of_it(served: Service) -> None:
    before = served.status()["event"]
    run_id = served.start()
    events = streamed(served, {"Last-Event-ID": str(before)})
    assert events[0][1] == "status"
    numbers = [int(number) for number, kind, _ in events if kind != "status"]
    assert numbers == list(range(before + 1, before + 1 + len(numbers)))
    entered = [event["data"]["state"] for _, kind, event in events if kind == "state"]
    assert list(dict.fromkeys(entered)) == [
        *("preflight", "measuring", "identifying", "staging", "activating", "verifying", "complete")
    ]
    balls = [event["data"] for _, kind, event in events if kind == "ball"]
    status = served.status()
    assert (status["state"], status["run_id"]) == ("complete", run_id)
    assert status["active_bank"] > 0
    assert status["balls"] == len(balls) > 20
    assert status["ve_now_um"] < status["ve_before_um"]
    summary = served.get("/api/runs?limit=1")["runs"][0]
    assert (summary["run_id"], summary["state"], summary["balls"]) == (run_id, "complete", len(balls))
    details = served.get(f"/api/runs/{run_id}")
    assert details["asked"]["source"] == "page"
    assert details["accepted"]
    assert {gate["name"] for gate in details["gates"]}
    kept = served.get(f"/api/runs/{run_id}/balls")
    assert [ball["centre_mm"] for ball in kept] == [ball["centre_mm"] for ball in balls]
    assert served.get(f"/api/runs/{run_id}/temperatures")[0]["celsius"]["artefact"] == pytest.approx(20.5, abs=0.5)
    assert [table["role"] for table in served.get("/api/tables")["kept"]][:2] == ["staged", "backup"]
    with served.client() as client:
        report = client.get(f"/api/runs/{run_id}/report")
    assert report.headers["content-type"].startswith("text/html")
    assert run_id in report.text


def test_hold_resume_abort_and_the_reset_that_it_takes(served: Service) -> None:
    run_id = served.start()
    served.until(lambda now: now["touches"] > 3, "touches")
    refused = served.post("/api/start", {"kind": "verify", "consent": True})
    assert refused.status_code == 409
    assert refused.headers["content-type"] == "application/problem+json"
    assert run_id in refused.json()["detail"]
    assert served.post("/api/hold").status_code == 200
    held = served.reached("held")
    assert set(held["may"]) == {"resume", "abort"}
    touches = held["touches"]
    assert served.status()["touches"] - touches <= 1
    assert served.post("/api/resume").status_code == 200
    served.until(lambda now: now["touches"] > touches + 3, "more touches")
    with served.client() as stranger:  # no token, from whoever stands there
        assert stranger.post("/api/abort", json={"reason": "a test"}).status_code == 200
    aborted = served.reached("aborted")
    assert aborted["alarms"][0]["code"] == 470
    assert "a test" in aborted["alarms"][0]["text"]
    assert aborted["may"] == ["reset"]
    sticky = served.post("/api/start", {"kind": "calibrate", "consent": True})
    assert sticky.status_code == 409
    assert "reset" in sticky.json()["hint"]
    assert served.post("/api/reset").status_code == 200
    assert served.status()["state"] == "idle"
    assert served.status()["alarms"] == []
    states = [e["record"]["state"] for e in served.get(f"/api/runs/{run_id}/events") if e["kind"] == "state"]
    assert states == ["preflight", "measuring", "held", "measuring", "aborting", "aborted"]


def test_a_link_that_breaks_is_a_fault_with_a_hint_that_outlives_the_service(tmp_path: Path) -> None:
    with simulator(tmp_path) as (machine, ready):
        config = short_settings(ready, tmp_path)
        with service(config) as running:
            run_id = running.start()
            running.until(lambda now: now["balls"] > 2, "balls")
            machine.kill()
            faulted = running.reached("faulted")
            [alarm] = faulted["alarms"]
            assert 310 <= alarm["code"] < 320
            assert alarm["hint"]
            assert alarm["where"]["step"].startswith(("measure/", "probe/"))
            assert running.end() == 0
            gone = running.command("status")
            assert gone.returncode == 3
            assert "systemctl start volcal" in gone.stderr
            assert "Traceback" not in gone.stderr
        with service(config) as again:
            left = again.status()
            assert (left["state"], left["run_id"]) == ("faulted", run_id)
            assert left["may"] == ["reset"]
            assert again.post("/api/reset").status_code == 200
            assert again.status()["unfinished"] == run_id
            assert "resume_run" in again.status()["may"]


def test_a_run_that_a_kill_has_interrupted_can_be_given_up(tmp_path: Path) -> None:
    with simulator(tmp_path) as (_, ready):
        config = short_settings(ready, tmp_path)
        with service(config) as running:
            run_id = running.start()
            running.until(lambda now: now["balls"] > 2, "balls")
            running.end(signal.SIGKILL)
        with service(config) as again:
            assert again.post("/api/give-up-run").status_code == 422  # not before the reset
            assert again.post("/api/reset").status_code == 200
            left = again.status()
            assert (left["unfinished"], {"resume_run", "give_up"} <= set(left["may"])) == (run_id, True)
            given_up = again.command("resume", "--give-up", "--json")  # asks the service, which owns the machine
            assert given_up.returncode == 0, given_up.stderr
            told = json.loads(given_up.stdout)
            assert (told["run_id"], told["done"]) == (run_id, "nothing had to be done")
            now = again.status()
            assert (now["unfinished"], {"resume_run", "give_up"} & set(now["may"])) == (None, set())
            (run,) = again.get("/api/runs?limit=1")["runs"]
            assert (run["run_id"], run["state"], run["balls"] > 2) == (run_id, "aborted", True)
            assert again.post("/api/resume-run").status_code == 422
            nothing = again.command("resume", "--give-up")
            assert (nothing.returncode, "give_up is not allowed in state idle" in nothing.stderr) == (2, True)


def test_a_lost_link_and_a_lost_table_are_told_between_runs_without_a_request(tmp_path: Path) -> None:
    often = f"{AT_ONCE}idle_read_period_s = 1.0\n"
    with simulator(tmp_path) as (machine, ready), service(short_settings(ready, tmp_path, often)) as running:
        running.start()
        running.reached("complete")
        known = wait_for(lambda: with_links(running, ok=True), "a reading")
        bank, vce_um = known["active_bank"], known["ve_now_um"]
        assert bank > 0
        assert vce_um > 0.0
        assert wait_for(lambda: running.status()["temperatures_c"], "a reading of the thermometer")
        machine.kill()
        lost = wait_for(lambda: with_links(running, ok=False), "the loss of the links")
        assert (lost["active_bank"], lost["ve_now_um"], lost["alarms"]) == (None, None, [])
        assert lost["read_problem"]
        assert lost["read_age_s"] > 0.0
        with simulator(tmp_path) as (_, anew):  # as after a power loss: its banks are empty
            short_settings(anew, tmp_path, often)
            running.process.send_signal(signal.SIGHUP)
            back = wait_for(lambda: with_links(running, ok=True), "another reading")
            assert (back["active_bank"], back["ve_now_um"], back["read_problem"]) == (0, None, "")
            [alarm] = back["alarms"]
            assert f"bank {bank} no longer holds its table" in alarm["hint"]
            assert {link["device"]: link["unread"] for link in back["links"]} == {"cnc": "", "mount": ""}


def with_links(running: Service, *, ok: bool) -> dict[str, Any] | None:
    """Return the status if it has links that all answer, or none of which answers."""
    now = running.status()
    return now if now["links"] and all(link["ok"] is ok for link in now["links"]) else None


def test_a_service_that_was_killed_says_so_and_could_go_on_after_a_reset(tmp_path: Path) -> None:
    with simulator(tmp_path) as (_, ready):
        config = short_settings(ready, tmp_path)
        with service(config) as running:
            run_id = running.start()
            running.until(lambda now: now["balls"] > 2, "balls")
            running.process.kill()
            running.process.wait(PATIENCE_S)
        with service(config) as again:
            left = again.status()
            assert (left["state"], left["run_id"]) == ("faulted", run_id)
            assert "interrupted" in left["alarms"][0]["text"]
            assert left["alarms"][0]["code"] == 480
            assert again.post("/api/reset").status_code == 200
            again.process.kill()
            again.process.wait(PATIENCE_S)
        with service(config) as once_more:
            assert once_more.status()["state"] == "idle"
            assert "resume_run" in once_more.status()["may"]


def test_the_end_of_the_service_withdraws_and_the_next_one_goes_on(tmp_path: Path) -> None:
    name = str(tmp_path / "notify")
    with simulator(tmp_path) as (_, ready), systemd_socket(name) as systemd:
        config = short_settings(ready, tmp_path)
        with service(config, NOTIFY_SOCKET=name) as running:
            assert systemd.told_until("READY")[-1]["READY"] == "1"
            run_id = running.start()
            systemd.told_until("STATUS", "measuring")
            running.until(lambda now: now["balls"] > 2, "balls")
            assert running.end() == 0
            assert systemd.told_until("STOPPING")
        assert not (tmp_path / "state" / "service.json").exists()
        stopped = [line for line in running.log() if line["event"] == "stopping"]
        assert stopped[0]["asked_by"] == "SIGTERM"
        assert all("step" in line for line in running.log() if line.get("state") == "aborting")
        with service(config) as again:
            left = again.status()
            assert (left["state"], left["run_id"]) == ("faulted", run_id)
            assert "the service is being stopped" in left["alarms"][0]["text"]
            assert again.post("/api/reset").status_code == 200
            answer = again.post("/api/resume-run")
            assert answer.status_code == 202, answer.text
            assert answer.json()["run_id"] == run_id
            ended = again.reached("complete", "faulted", "refused")
            assert ended["state"] == "complete", ended["alarms"]
    keys = [ball.key for ball in stored_run(tmp_path / "state", run_id).balls]
    assert len(keys) == len(set(keys)) > 20


def test_the_watchdog_is_fed_through_an_abstract_socket_and_settings_are_reloaded(tmp_path: Path) -> None:
    name = f"@volcal-test-{os.getpid()}"
    with simulator(tmp_path) as (_, ready), systemd_socket(name) as systemd:
        config = short_settings(ready, tmp_path)
        with service(config, NOTIFY_SOCKET=name, WATCHDOG_USEC="600000") as running:
            assert systemd.told_until("READY")
            for _ in range(3):  # an idle service is alive
                assert systemd.told_until("WATCHDOG")[-1] == {"WATCHDOG": "1"}
            assert running.get("/api/machine")["slot_minutes"] == 15.0
            good = config.read_text()
            config.write_text(good + "\n[nightly]\nslot_minutes = 20.0\n")
            running.process.send_signal(signal.SIGHUP)
            assert "MONOTONIC_USEC" in systemd.told_until("RELOADING")[-1]
            assert systemd.told_until("READY")
            assert running.get("/api/machine")["slot_minutes"] == 20.0
            config.write_text(good + "\n[nightly]\nslot_minutes = -1.0\n")
            running.process.send_signal(signal.SIGHUP)
            systemd.told_until("RELOADING")
            assert "slot_minutes" in systemd.told_until("READY")[-1]["STATUS"]
            assert running.get("/api/machine")["slot_minutes"] == 20.0
            config.write_text(good)
            running.start()
            running.until(lambda now: now["touches"] > 3, "touches")
            running.process.send_signal(signal.SIGHUP)
            systemd.told_until("RELOADING")
            assert "in progress" in systemd.told_until("READY")[-1]["STATUS"]
            assert running.status()["state"] == "measuring"


def test_the_commands_and_their_exit_codes(served: Service) -> None:
    """After the whole run above, which wrote the table that is verified here."""
    waited = served.command("start", "--kind", "verify", "--stations", "1", "--wait")
    assert waited.returncode == 0, waited.stderr
    run_id = waited.stdout.split()[0]
    shown = json.loads(served.command("status", "--json").stdout)
    assert (shown["run_id"], shown["state"]) == (run_id, "complete")
    assert "complete" in served.command("status").stdout
    assert served.command("abort").returncode == 0
    nothing = served.command("hold")
    assert nothing.returncode == 2
    assert "is not allowed in state" in nothing.stderr
    assert served.command("reset").returncode == 0
    other = served.command("calibrate")
    assert other.returncode == 4
    assert "the service (process" in other.stderr
    too_short = served.command("start", "--kind", "calibrate", "--slot", "1min", "--wait")
    assert too_short.returncode == 4
    assert "min of machine time" in too_short.stderr
    assert "Traceback" not in "".join(r.stderr for r in (nothing, other, too_short))


def test_an_abort_during_the_preflight_ends_the_run_before_anything_moves(served: Service) -> None:
    run_id = served.start()
    assert served.post("/api/abort", {"reason": "a test"}).status_code == 200
    aborted = served.reached("aborted")
    assert aborted["touches"] == 0
    assert "a test" in aborted["alarms"][0]["text"]
    states = [e["record"]["state"] for e in served.get(f"/api/runs/{run_id}/events") if e["kind"] == "state"]
    assert states == ["preflight", "aborting", "aborted"]


def test_two_services_never_own_one_machine(served: Service) -> None:
    second = served.command("serve")
    assert second.returncode == 4
    assert "the service (process" in second.stderr


def test_a_command_for_another_machine_with_the_same_state_directory_is_refused(served: Service) -> None:
    settings = tomllib.loads(served.config.read_text())
    own = Path(settings["machine"])
    other = served.directory / "other-machine.toml"
    other.write_text(own.read_text())
    config = served.directory / "other.toml"
    config.write_text(served.config.read_text().replace(settings["machine"], str(other)))
    for command in (["start", "--kind", "calibrate", "--consent"], ["resume"], ["status"], ["reset"]):
        refused = served.command(*command, config=config)
        assert refused.returncode == 2, refused.stdout
        assert f"not for that in {other}" in refused.stderr
    assert served.command("abort", config=config).returncode == 0
    assert served.status()["state"] not in ("preflight", "measuring")


def test_a_question_waits_for_an_answer_of_any_door(tmp_path: Path) -> None:
    with simulator(tmp_path) as (_, ready):
        config = short_settings(ready, tmp_path)
        text = config.read_text()
        operator = text[text.index("[devices.operator]") : text.index("[roles]")]
        config.write_text(text.replace(operator, '[devices.operator]\ndriver = "console-operator"\n\n'))
        with service(config) as running:
            running.start()
            question = running.until(lambda now: now["question"], "the question")
            assert "station" in question["text"]
            wrong = running.post("/api/answer", {"number": question["number"] + 1, "yes": True})
            assert wrong.status_code == 422
            assert running.post("/api/answer", {"number": question["number"], "yes": True}).status_code == 200
            running.until(lambda now: now["touches"] > 0, "touches")
            assert running.status()["question"] is None
            running.post("/api/abort")
            running.reached("aborted")
            running.post("/api/reset")
            running.start()
            running.until(lambda now: now["question"], "the question")
            running.post("/api/abort")
            assert running.reached("aborted")["question"] is None


def raw(running: Service, request: bytes) -> bytes:
    """Everything that is answered until the other side closes."""
    host, _, port = running.url.removeprefix("http://").partition(":")
    with socket.create_connection((host, int(port)), timeout=PATIENCE_S) as link:
        link.sendall(request)
        answer = b""
        while chunk := link.recv(65536):
            answer += chunk
        return answer


def test_strangers_are_kept_out(served: Service) -> None:
    body = {"kind": "calibrate", "consent": True}
    with served.client() as client:
        missing = client.post("/api/start", json=body)
        assert missing.status_code == 401
        assert missing.headers["www-authenticate"] == "Bearer"
        wrong = client.post("/api/start", json=body, headers={"Authorization": "Bearer wrong"})
        assert wrong.status_code == 403
        rebound = client.get("/api/status", headers={"Host": "evil.example"})
        assert rebound.status_code == 421
        strange = client.post("/api/abort", headers={"Origin": "http://evil.example"})
        assert strange.status_code == 403
        assert client.post("/api/abort", headers={"Origin": served.url}).status_code == 200
        large = client.post("/api/hold", content=b"x" * 100_000)
        assert large.status_code == 413
        assert client.get("/api/runs/../../etc/passwd").status_code == 404
    malformed = raw(
        served,
        f"POST /api/start HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {served.token}\r\n"
        "Content-Type: application/json\r\nConnection: close\r\nContent-Length: 5\r\n\r\n{oops".encode(),
    )
    assert malformed.startswith(b"HTTP/1.1 400")
    assert b"the body is not JSON" in malformed
    assert raw(served, b"GET /api/status HTTP/1.1\r\nHost: [::1\r\nConnection: close\r\n\r\n").startswith(
        b"HTTP/1.1 421"
    )
    unknown = served.post("/api/start", {"kind": "explode"})
    assert unknown.status_code == 422
    assert unknown.json()["where"] == {"key": "kind"}
    path = served.post("/api/start", {"kind": "calibrate", "position_set": "../../etc/passwd.csv"})
    assert path.status_code == 422
    assert served.status()["state"] == "idle"


def test_metrics_for_prometheus(served: Service) -> None:
    """After the whole run above."""
    for _ in range(2):  # what has been fitted, and what is kept of it
        with served.client() as client:
            answer = client.get("/metrics")
        assert answer.status_code == 200, answer.text
        assert answer.headers["content-type"].startswith("text/plain; version=0.0.4")
    lines = answer.text.splitlines()
    assert 'volcal_run_under_way{machine="case-study"} 0.0' in lines
    assert 'volcal_runs{kind="calibrate",machine="case-study",state="complete"} 1.0' in lines


def test_a_service_with_a_certificate_is_spoken_to_by_the_commands(tmp_path: Path) -> None:
    certificate, key = self_signed(tmp_path)
    with simulator(tmp_path) as (_, ready):
        config = short_settings(ready, tmp_path)
        named = f'certificate_file = "{certificate}"\nkey_file = "{key}"\n'
        config.write_text(config.read_text() + f'host = "0.0.0.0"\n{named}')
        with service(config) as running:
            assert running.url.startswith("https://")
            shown = running.command("status", "--json")
            assert shown.returncode == 0, shown.stderr
            assert json.loads(shown.stdout)["state"] == "idle"
            stranger, _ = self_signed(tmp_path, "stranger")
            config.write_text(config.read_text().replace(str(certificate), str(stranger)))
            refused = running.command("status")
            assert refused.returncode == 3
            assert "certificate" in refused.stderr.lower()


def self_signed(directory: Path, name: str = "volcal") -> tuple[Path, Path]:
    """Certificate and key of `name`, as files."""
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, name)])
    now = datetime.now(UTC)
    builder = x509.CertificateBuilder(subject, subject, key.public_key(), x509.random_serial_number())
    signed = builder.not_valid_before(now - timedelta(days=1)).not_valid_after(now + timedelta(days=1))
    authority = signed.add_extension(x509.BasicConstraints(ca=True, path_length=None), critical=True)
    certificate, private = directory / f"{name}.pem", directory / f"{name}.key"
    certificate.write_bytes(authority.sign(key, hashes.SHA256()).public_bytes(Encoding.PEM))
    private.write_bytes(key.private_bytes(Encoding.PEM, PrivateFormat.PKCS8, NoEncryption()))
    return certificate, private


def test_the_token_is_the_owners_alone(served: Service) -> None:
    token = served.state / "token"
    assert token.stat().st_mode & 0o777 == 0o600
    assert served.token not in (served.directory / "log").read_text()
    token.chmod(0o644)
    try:
        open_to_all = served.command("hold")
    finally:
        token.chmod(0o600)
    assert open_to_all.returncode == 2
    assert "chmod 600" in open_to_all.stderr


def test_a_kept_table_acts_again(served: Service) -> None:
    """The table of the whole run above gives way to what acted before it, and is had back."""
    kept = served.get("/api/tables")["kept"]
    written = next(table for table in kept if table["role"] == "staged")
    for role, expected in (("backup", 0), ("staged", None)):
        answer = served.post("/api/tables/restore", {"run_id": written["run_id"], "role": role})
        assert answer.status_code == 202, answer.text
        status = served.reached("complete", "faulted", "refused")
        assert status["state"] == "complete"
        assert status["touches"] == 0
        if expected is not None:
            assert status["active_bank"] == expected
    now = served.get("/api/tables")
    last = now["kept"][0]
    assert (last["crc32"], last["bank"]) == (written["crc32"], now["active_bank"])
    unknown = served.post("/api/tables/restore", {"run_id": "nobody"})
    assert unknown.status_code == 422
