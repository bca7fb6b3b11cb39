"""OPC UA endpoint with a fake control, and clients with certificates."""

from __future__ import annotations

import asyncio
import contextlib
import json
import os
import secrets
import shutil
import socket
import subprocess
from collections.abc import AsyncIterator, Iterator, Mapping
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
from aloud import NOT_HERE
from asyncua import Client, ua
from asyncua.crypto.security_policies import SecurityPolicyBasic256Sha256
from cryptography import x509
from cryptography.hazmat.primitives import hashes, serialization
from cryptography.hazmat.primitives.asymmetric import rsa
from fake_control import FakeControl

from agent.execution.journal import Journal
from agent.execution.journal_reader import open_journal
from agent.execution.states import RunState
from agent.results.decision_kinds import OUTCOME, PROBE, PROOF
from agent.service.opcua.endpoint import OpcUaEndpoint
from agent.settings.opcua import OpcUaSettings
from drivers.clock import VirtualClock

PEER = Path(__file__).parent / "peers" / "node"
TOKEN = secrets.token_urlsafe()
WITHIN_S = 300.0


def certificate(directory: Path, name: str, *, valid_for=timedelta(days=2)) -> tuple[Path, Path]:
    """Create a client's own certificate and key."""
    directory.mkdir(exist_ok=True)
    key = rsa.generate_private_key(public_exponent=65537, key_size=2048)
    subject = x509.Name([x509.NameAttribute(x509.NameOID.COMMON_NAME, name)])
    begin = datetime.now(UTC) - timedelta(days=1)
    made = (
        x509.CertificateBuilder()
        .subject_name(subject)
        .issuer_name(subject)
        .public_key(key.public_key())
        .serial_number(x509.random_serial_number())
        .not_valid_before(begin)
        .not_valid_after(begin + valid_for)
        .add_extension(x509.SubjectAlternativeName([x509.UniformResourceIdentifier(f"urn:{name}")]), critical=False)
        .sign(key, hashes.SHA256())
    )
    der, pem = directory / f"{name}.der", directory / f"{name}.pem"
    der.write_bytes(made.public_bytes(serialization.Encoding.DER))
    pem.write_bytes(
        key.private_bytes(serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption())
    )
    return der, pem


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


class World:
    """Open endpoint with one trusted and one unknown client certificate."""

    def __init__(self, directory: Path, **settings: Any) -> None:
        self.state = directory / "state"
        self.control = FakeControl()
        self.endpoint = OpcUaEndpoint(OpcUaSettings(port=free_port(), **settings), self.state, TOKEN)
        self.known = certificate(directory, "known")
        self.strange = certificate(directory, "strange")

    @property
    def url(self) -> str:
        host, port = self.endpoint.address
        return f"opc.tcp://{host}:{port}/volcal"

    def trust(self, path: Path) -> None:
        (self.endpoint.trusted_clients / path.name).write_bytes(path.read_bytes())

    def client(self, *, password: str | None = TOKEN, pair: tuple[Path, Path] | None = None) -> Client:
        client = Client(self.url, timeout=WITHIN_S)
        if password is not None:
            client.set_user("panel 1")
            client.set_password(password)
        self.pair = pair or self.known
        return client

    @contextlib.asynccontextmanager
    async def connected(self, **how) -> AsyncIterator[Client]:
        client = self.client(**how)
        await secure(client, self, self.pair)
        async with client:
            yield client


async def secure(client: Client, world: World, pair: tuple[Path, Path]) -> None:
    client.application_uri = f"urn:{pair[0].stem}"
    own = world.state / "opcua" / "own" / "certificate.der"
    await client.set_security(SecurityPolicyBasic256Sha256, str(pair[0]), str(pair[1]), server_certificate=str(own))


def opened(directory: Path, **settings: Any) -> Iterator[World]:
    world = World(directory, **settings)
    world.endpoint.start(world.control)
    world.trust(world.known[0])
    try:
        yield world
    finally:
        world.endpoint.stop()


def own_id(name: str) -> ua.NodeId:
    """Return the identifier of a node of volcal's own namespace."""
    return ua.NodeId(ua.String(name), ua.Int16(2))


def node(client: Client, path: str):
    return client.get_node(own_id(path))


async def read(client: Client, path: str):
    return await node(client, path).read_value()


def calibrated(state: Path, run_id: str, *, vce_um: float, probe: Mapping[str, Any] | None = None) -> str:
    """Write a calibration that has ended into the journal, and return the time of its end. `probe` is what it records
    of the checks of the probe, whose serial number its settings name."""
    journal = Journal(state)
    settings = {"machine": "m.toml", "opcua": {"probe": {"serial_number": "A-16"}}}
    run = journal.start_run(run_id, "calibrate", settings, "0.1.0", VirtualClock())
    run.state(RunState.PREFLIGHT)
    run.origin({})
    run.begun()
    if probe is not None:
        run.decision(PROBE, probe)
    run.decision(PROOF, {"accepted": True})
    run.state(RunState.COMPLETE, final=True)
    run.decision(OUTCOME, {"estimated_ve_um": 38.5, "predicted_vce_um": vce_um})
    journal.close()

    with open_journal(state) as reader:
        return str(reader.require_run(run_id).ended)


def machine_node(client: Client, path: str):
    return client.get_node(own_id(f"Machine.{path}"))


async def status_of(client: Client, path: str) -> int:
    return (await machine_node(client, path).read_data_value(raise_on_bad_status=False)).StatusCode.value


async def until(client: Client, path: str, value) -> None:
    async with asyncio.timeout(WITHIN_S):
        while (await machine_node(client, path).read_data_value(raise_on_bad_status=False)).Value.Value != value:
            await asyncio.sleep(0.01)


def pem_of(der: Path) -> Path:
    pem = der.with_suffix(".crt.pem")
    pem.write_bytes(x509.load_der_x509_certificate(der.read_bytes()).public_bytes(serialization.Encoding.PEM))
    return pem


def node_modules() -> Path:
    return Path(os.environ.get("VOLCAL_NODE_MODULES", PEER / "node_modules"))


def require_node() -> None:
    if shutil.which("node") is None or not (node_modules() / "node-opcua-client").is_dir():
        pytest.skip(f"{NOT_HERE}: OPC UA with node-opcua-client: node or its packages are missing (.ci/install-node)")


def browsed_by_node(world: World, directory: Path) -> dict[str, Any]:
    """Return what the client of node-opcua finds of the first machine."""
    require_node()
    der, key = world.known
    said = subprocess.run(
        ["node", str(PEER / "machine.js"), world.url, str(directory / "pki"), str(pem_of(der)), str(key), "urn:known",
         TOKEN],
        env={**os.environ, "NODE_PATH": str(node_modules())}, capture_output=True, text=True, timeout=WITHIN_S,
        check=False,
    )  # fmt: skip
    assert said.returncode == 0, said.stderr
    found: dict[str, Any] = json.loads(said.stdout.splitlines()[-1])
    return found
