"""A panel and a client of OPC UA at the night service: real `volcal serve`, a simulator over its real links,
pyModbusTCP as the panel."""

from __future__ import annotations

import asyncio
import shutil
import signal
import socket
import struct
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from pyModbusTCP.client import ModbusClient
from simulated import configured, simulated

from agent.service.opcua.certificates import own_certificate

ROOT = Path(__file__).resolve().parents[2]
SCENARIO = ROOT / "config" / "simulators" / "case-study.toml"
CODE = 271828182
PATIENCE_S = 600.0
# Addresses and numbers as a panel's programmer has them from docs/reference/panel-gateway.md.
STATE, PACKML, KIND, MAY, PROGRESS, MINUTES, BALLS, ALARM_COUNT = 3, 4, 5, 6, 7, 8, 14, 20
ACCEPTED, RESULT, COMMAND = 28, 29, 200
START, RESET = 1, 5
IDLE, MEASURING, ABORTED = 0, 2, 12
DONE, BUSY = 1, 460


def free_ports(count: int) -> list[int]:
    listeners = [socket.create_server(("127.0.0.1", 0)) for _ in range(count)]
    ports = [listener.getsockname()[1] for listener in listeners]
    for listener in listeners:
        listener.close()
    return ports


@pytest.fixture
def simulator() -> Iterator[dict[str, Any]]:
    with simulated() as (_, ready):
        yield ready


@pytest.fixture
def serving(simulator, tmp_path: Path) -> Iterator[tuple[Service, ModbusClient, Hall]]:
    config = configured(simulator, tmp_path)
    http, gateway, opcua = free_ports(3)
    (tmp_path / "code").write_text(f"{CODE}\n")
    (tmp_path / "code").chmod(0o600)
    config.write_text(
        config.read_text()
        + f"\n[service]\nport = {http}\nwarm_up_minutes = 0\n"
        + f'\n[gateway]\nenabled = true\nport = {gateway}\naccess_code_file = "code"\n'
        + f"\n[opcua]\nenabled = true\nport = {opcua}\n"
    )
    log = (tmp_path / "serve.log").open("w")
    with subprocess.Popen(
        [sys.executable, "-m", "agent.cli.main", "serve", "--config", str(config)],
        cwd=tmp_path, stdout=log, stderr=subprocess.STDOUT, text=True,
    ) as process:  # fmt: skip
        client = ModbusClient(host="127.0.0.1", port=gateway, timeout=600.0)
        try:
            service = Service(process, tmp_path / "serve.log")
            service.until(client.open)
            yield service, client, Hall(tmp_path, opcua)
        finally:
            client.close()
            process.kill()
            process.wait(10.0)
            log.close()


@dataclass(frozen=True)
class Hall:
    """Somebody else in the plant, who reads over OPC UA with a certificate of its own and the service's token."""

    directory: Path
    port: int

    def read(self, *paths: str) -> list[Any]:
        state = self.directory / "state"
        made = own_certificate(self.directory / "client", "urn:hall", "hall", "127.0.0.1")
        shutil.copy(made.certificate, state / "opcua" / "trusted" / "hall.der")

        async def look() -> list[Any]:
            client = Client(f"opc.tcp://127.0.0.1:{self.port}/volcal", timeout=600.0)
            client.application_uri = "urn:hall"
            client.set_user("hall")
            client.set_password((state / "token").read_text().strip())
            await client.set_security(
                SecurityPolicyBasic256Sha256,
                str(made.certificate),
                str(made.key),
                server_certificate=str(state / "opcua" / "own" / "certificate.der"),
            )
            async with client:
                return [await client.get_node(ua.NodeId(ua.String(path), ua.Int16(2))).read_value() for path in paths]

        return asyncio.run(look())


@dataclass(frozen=True)
class Service:
    process: subprocess.Popen[str]
    log: Path

    def until(self, condition: Callable[[], Any]) -> None:
        """Wait, within bounds, while the service lives; else its log is the message."""
        deadline = time.monotonic() + PATIENCE_S
        while not condition():
            assert self.process.poll() is None, self.log.read_text()
            assert time.monotonic() < deadline, self.log.read_text()
            time.sleep(0.02)


def read(client: ModbusClient, address: int, count: int = 1) -> Any:
    words = client.read_holding_registers(address, count)
    assert words is not None, client.last_error_as_txt
    return words[0] if count == 1 else struct.unpack(">I", struct.pack(">2H", *words))[0]


def give(client: ModbusClient, command: int) -> int:
    sequence = read(client, ACCEPTED) % 65535 + 1
    data = (
        struct.pack(">6HIH", command, 1, 1, 0, 0, 1, 0, 0) + b"S1".ljust(32, b"\0") + struct.pack(">IH", CODE, sequence)
    )
    assert client.write_multiple_registers(COMMAND, list(struct.unpack(f">{len(data) // 2}H", data)))
    assert read(client, ACCEPTED) == sequence
    return read(client, RESULT)


def test_a_panel_starts_watches_and_aborts_a_run(serving):
    service, panel, hall = serving
    service.until(lambda: read(panel, STATE) == IDLE and read(panel, MAY) & 1)
    assert give(panel, START) == DONE
    assert give(panel, START) == BUSY
    service.until(lambda: read(panel, STATE) == MEASURING and read(panel, BALLS, 2) >= 3)
    assert (read(panel, PACKML), read(panel, KIND)) == (6, 1)
    assert 0 < read(panel, MINUTES, 2) < 0xFFFFFFFF
    before = read(panel, PROGRESS)
    assert 0 < before < 10000
    assert hall.read("Monitoring/PackMLState", "Production/Job/Kind") == ["Execute", "calibrate"]
    service.until(lambda: read(panel, PROGRESS) > before)
    assert panel.write_single_coil(0, True)
    service.until(lambda: read(panel, STATE) == ABORTED)
    assert read(panel, PACKML) == 9
    assert give(panel, RESET) == DONE
    service.until(lambda: read(panel, STATE) == IDLE)
    assert read(panel, ALARM_COUNT) == 0
    service.process.send_signal(signal.SIGTERM)
    assert service.process.wait(PATIENCE_S) == 0
