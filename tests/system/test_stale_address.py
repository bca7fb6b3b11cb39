"""The address file of a service that was killed: nobody at that address is sent the token."""

from __future__ import annotations

import json
import os
import signal
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from service_process import service, short_settings, simulator
from simulated import COMMAND, PATIENCE_S
from stored_run import stored_run

from agent.service.address_file import ADDRESS_FILE, read_address, write_address

HOLDER = """
import sys
from pathlib import Path
from agent.service.address_file import write_address
remove = write_address(Path(sys.argv[1]), "http://127.0.0.1:1")
print("written", flush=True)
sys.stdin.read()
"""


def test_an_address_is_trusted_as_long_as_its_process_holds_the_lock(tmp_path: Path) -> None:
    command = [sys.executable, "-c", HOLDER, str(tmp_path)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout is not None
        assert holder.stdout.readline() == "written\n"
        assert read_address(tmp_path) == "http://127.0.0.1:1"
        other = {"url": "http://127.0.0.1:1", "process": os.getpid()}
        (tmp_path / ADDRESS_FILE).write_text(json.dumps(other))  # the lock stays on this file
        with pytest.raises(FileNotFoundError):
            read_address(tmp_path)
        (tmp_path / ADDRESS_FILE).write_text("[]")
        with pytest.raises(ValueError, match="no JSON object"):
            read_address(tmp_path)
        (tmp_path / ADDRESS_FILE).write_text(json.dumps(other | {"process": holder.pid}))
        assert read_address(tmp_path) == "http://127.0.0.1:1"
        holder.kill()
    with pytest.raises(FileNotFoundError):
        read_address(tmp_path)


def test_the_file_goes_with_the_service(tmp_path: Path) -> None:
    remove = write_address(tmp_path, "http://127.0.0.1:1")
    assert [path.name for path in tmp_path.iterdir()] == [ADDRESS_FILE]
    remove()
    assert not list(tmp_path.iterdir())


def test_after_a_killed_service_no_command_speaks_to_its_address_and_resume_goes_on(tmp_path: Path) -> None:
    with simulator(tmp_path) as (_, ready):
        config = short_settings(ready, tmp_path)
        with service(config) as running:
            run_id = running.start()
            running.until(lambda now: now["balls"] > 2, "balls")
            running.end(signal.SIGKILL)
            port = int(running.url.rsplit(":", 1)[1])
        with socket.create_server(("127.0.0.1", port)) as stranger:
            stranger.setblocking(False)
            for command in ("status", "reset", "hold"):
                done = running.command(command)
                assert done.returncode == 3
                assert "no service runs for this machine" in done.stderr
            resumed = subprocess.run(
                [*COMMAND, "resume", "--config", str(config)], timeout=PATIENCE_S, capture_output=True, check=False
            )
            assert resumed.returncode == 0, resumed.stderr
            with pytest.raises(BlockingIOError):
                stranger.accept()
    assert len(stored_run(tmp_path / "state", run_id).balls) > 20
