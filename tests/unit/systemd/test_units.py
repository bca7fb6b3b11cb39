"""The units as systemd reads them, and what they start as the command line reads it."""

from __future__ import annotations

import os
import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import click
import pytest

from agent.cli.errors import VolcalGroup
from agent.cli.main import main
from agent.cli.service_commands.start import DECLINED
from agent.execution.run_lock import ownership, run_lock

ROOT = Path(__file__).resolve().parents[3]
UNITS = ROOT / "systemd"
SERVICES = ("volcal.service", "volcal-nightly.service")
EXPOSURE_TENTHS = 18
OF_ONE_ONLY = {
    # what only the service needs, or only the one that asks
    "Type", "NotifyAccess", "ExecStart", "ExecReload", "KillMode", "TimeoutStartSec", "TimeoutStopSec",
    "TimeoutAbortSec", "WatchdogSec", "Restart", "RestartSec", "RestartPreventExitStatus", "SuccessExitStatus",
    "StateDirectory", "StateDirectoryMode", "ConfigurationDirectory", "LoadCredential", "RestrictAddressFamilies",
    "PrivateDevices", "RemoveIPC",
    # what is said of each, and how it comes up
    "Description", "Documentation", "Wants", "After", "WantedBy", "StartLimitIntervalSec", "StartLimitBurst",
}  # fmt: skip
FAULTHANDLER = "PYTHONFAULTHANDLER=1"


def settings(unit: str) -> dict[str, list[str]]:
    """Every key of a unit with its values, in their order."""
    found: dict[str, list[str]] = {}
    for line in (UNITS / unit).read_text(encoding="utf-8").splitlines():
        if "=" in line and not line.startswith("#"):
            key, value = line.split("=", 1)
            found.setdefault(key, []).append(value)
    return found


@pytest.fixture
def installed(tmp_path: Path) -> Path:
    """The units and the example drop-in side by side, starting this environment's program."""
    program = Path(sys.executable).with_name("volcal")
    assert program.is_file(), "install the project: make setup"
    for unit in (*SERVICES, "volcal-nightly.timer"):
        (tmp_path / unit).write_text((UNITS / unit).read_text().replace("/usr/bin/volcal", str(program)))
    (tmp_path / "volcal.service.d").mkdir()
    shutil.copy(UNITS / "examples" / "machine.conf", tmp_path / "volcal.service.d")
    return tmp_path


def analyze(*words: str, folder: Path) -> str:
    program = shutil.which("systemd-analyze")
    assert program is not None, "systemd-analyze is missing, and the units go unchecked: apt-get install systemd"
    done = subprocess.run([program, *words], check=False, cwd=folder, capture_output=True, text=True, timeout=600.0)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


def test_systemd_reads_every_unit_without_a_word(installed: Path) -> None:
    names = sorted(f"./{path.name}" for path in installed.glob("volcal*.*") if path.is_file())
    assert analyze("verify", "--man=no", *names, folder=installed) == ""


@pytest.mark.parametrize("unit", SERVICES)
def test_little_is_exposed_with_serial_lines_can_and_one_address(installed: Path, unit: str) -> None:
    options = ("--offline=yes", f"--threshold={EXPOSURE_TENTHS}", "--no-pager")
    shown = analyze("security", *options, f"./{unit}", folder=installed)
    found = re.search(r"Overall exposure level for \S+: ([0-9.]+)", shown)
    assert found is not None
    assert 10.0 * float(found.group(1)) <= EXPOSURE_TENTHS
    if unit == "volcal.service":
        assert "char-ttyUSB:rw" in shown, "the drop-in was not read"
        assert "non-localhost" in shown


def test_the_one_that_asks_is_as_confined_as_the_service() -> None:
    one, other = (
        {key: values for key, values in settings(unit).items() if key not in OF_ONE_ONLY} for unit in SERVICES
    )
    one["Environment"].remove(FAULTHANDLER)
    assert one == other


@pytest.mark.parametrize("unit", SERVICES)
def test_what_is_started_is_what_the_command_line_takes(unit: str) -> None:
    (line,) = settings(unit)["ExecStart"]
    program, name, *words = shlex.split(line)
    assert program == "/usr/bin/volcal"
    assert isinstance(main, VolcalGroup)
    command = main.get_command(click.Context(main), name)
    assert command is not None
    parsed = command.make_context(name, list(words))
    assert str(parsed.params["config"]) == "/etc/volcal/volcal.toml"
    if name == "start":
        assert (parsed.params["kind"], parsed.params["wait"], parsed.params["consent"]) == ("nightly", True, False)


def test_no_missed_night_is_made_up_for() -> None:
    timer = settings("volcal-nightly.timer")
    assert timer["Persistent"] == ["false"]
    assert timer["WakeSystem"] == ["false"]
    assert timer["FixedRandomDelay"] == ["true"]
    assert not any("Persistent=true" in path.read_text() for path in UNITS.rglob("*") if path.is_file())


def test_a_start_that_was_declined_is_no_failure() -> None:
    assert settings("volcal-nightly.service")["SuccessExitStatus"] == [str(DECLINED)]


def test_the_end_of_a_run_has_the_time_that_the_service_gives_it() -> None:
    """The service extends the time by itself; at its default the unit's own would do."""
    (seconds,) = settings("volcal.service")["TimeoutStopSec"]
    assert int(seconds.removesuffix("s")) >= 60


def test_both_read_the_same_secret() -> None:
    assert "token:volcal.token" in settings("volcal-nightly.service")["LoadCredential"]
    names = ("token", "panel-code", "mqtt-password", "webhook-key", "mail-password")
    assert settings("volcal.service")["LoadCredential"] == [f"{name}:volcal.{name}" for name in names]


@pytest.mark.parametrize("script", ["postinst", "prerm", "postrm"])
def test_maintainer_scripts_are_shell(script: str) -> None:
    done = subprocess.run(["sh", "-n", UNITS / "deb" / script], check=False, capture_output=True, timeout=600.0)
    assert done.returncode == 0, done.stderr


class Removal:
    """The script that runs before the package is replaced or removed, with folders of its own and a systemd that says
    whether the service is active."""

    def __init__(self, directory: Path) -> None:
        self.state, self._bin, self._script = directory / "state", directory / "bin", directory / "prerm"
        for folder in (self.state, self._bin, directory / "systemd", directory / "volcal" / "lib"):
            folder.mkdir(parents=True)
        self.stopped = directory / "stopped"
        self.removed = directory / "volcal" / "lib" / "__pycache__"
        self.removed.mkdir()
        text = (UNITS / "deb" / "prerm").read_text()
        for path, own in (
            ("/usr/lib/volcal", directory / "volcal"),
            ("/run/systemd/system", directory / "systemd"),
            ("/run/volcal", directory / "volcal"),
            ("/var/lib/volcal", self.state),
        ):
            text = text.replace(path, str(own))
        self._script.write_text(text)

    def run(self, action: str, *, active: bool) -> subprocess.CompletedProcess[str]:
        systemctl = self._bin / "systemctl"
        answer = 0 if active else 3
        systemctl.write_text(f'#!/bin/sh\ncase "$*" in *is-active*) exit {answer};; esac\ntouch {self.stopped}\n')
        systemctl.chmod(0o755)
        paths = {"PATH": f"{self._bin}:{os.environ['PATH']}"}
        command = ["sh", str(self._script), action]
        return subprocess.run(command, check=False, capture_output=True, text=True, timeout=600.0, env=paths)


@pytest.fixture
def removal(tmp_path: Path) -> Removal:
    return Removal(tmp_path)


@pytest.mark.parametrize("action", ["upgrade", "failed-upgrade", "remove", "deconfigure"])
def test_the_package_stays_while_a_run_of_the_command_line_holds_the_machine(removal: Removal, action: str) -> None:
    with run_lock(removal.state, "20261201T100000Z-abcd"):
        refused = removal.run(action, active=False)
        assert refused.returncode == 1
        assert "run 20261201T100000Z-abcd" in refused.stderr
        assert "refused" in refused.stderr
        assert removal.removed.exists()
        assert not removal.stopped.exists()
    assert removal.run(action, active=False).returncode == 0
    assert not removal.removed.exists()


@pytest.mark.parametrize("active", [False, True])
def test_the_package_stays_while_a_command_holds_a_machine_elsewhere(
    removal: Removal, tmp_path: Path, active: bool
) -> None:
    python = tmp_path / "volcal" / "bin" / "python3"
    python.parent.mkdir()
    python.symlink_to(sys.executable)
    elsewhere = tmp_path / "state of machine 2" / "run.lock"
    elsewhere.parent.mkdir()
    holder = (
        "import fcntl, sys\nlock = open(sys.argv[1], 'w')\nfcntl.flock(lock, fcntl.LOCK_EX)\n"
        "print('run of machine 2', file=lock, flush=True)\nprint('held', flush=True)\nsys.stdin.read()"
    )
    command = [str(python), "-c", holder, str(elsewhere)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout is not None
        assert run.stdout.readline() == "held\n"
        refused = removal.run("remove", active=active)
        assert (refused.returncode, "owned by run of machine 2" in refused.stderr) == (1, True)
        assert not removal.stopped.exists()
        run.kill()
    assert removal.run("remove", active=active).returncode == 0


@pytest.mark.parametrize("action", ["upgrade", "remove"])
def test_a_machine_that_never_ran_is_no_reason_to_keep_the_package(removal: Removal, action: str) -> None:
    assert removal.run(action, active=False).returncode == 0
    assert list(removal.state.iterdir()) == [], "a lock of root keeps the service from its own"


def test_the_lock_of_the_service_itself_does_not_keep_the_package(removal: Removal) -> None:
    with ownership(removal.state, "service"):
        assert removal.run("remove", active=True).returncode == 0
    assert removal.stopped.exists()


def test_the_installation_says_that_it_compiles_before_it_does(tmp_path: Path) -> None:
    """Minutes without a word look like a hang."""
    script = (UNITS / "deb" / "postinst").read_text()
    head, _, _ = script.partition("\nstart_again()")
    assert "/usr/lib/volcal/bin/python3 -m compileall" in head
    (tmp_path / "postinst").write_text(f"{head.replace('/usr/lib/volcal/bin/python3', 'echo RUN')}\ncompile\n")
    done = subprocess.run(["sh", tmp_path / "postinst"], check=True, capture_output=True, text=True, timeout=600.0)
    before, ran, after = done.stdout.splitlines()
    assert "compiling" in before
    assert "minutes" in before
    assert ran.startswith("RUN -m compileall")
    assert after == "volcal: compiled"
