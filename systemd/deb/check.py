"""Command `make deb-test`: the package on a really booting Debian, from first installation until it is purged.

Needs root, debootstrap and systemd-container. Ends with one line of JSON; the first failed check ends it at once.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from container import NEEDED, Container, base_root, booted_container, wait_for
from plant import SETTINGS, STATE, end_simulator, start_simulator, write_settings

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]
WORK = ROOT / "build" / "nspawn"
SERVICE = "volcal.service"
NIGHTLY = "volcal-nightly.service"
TIMER = "volcal-nightly.timer"
PATIENCE_S = 120.0
DECLINED = 6
QUICK_WATCHDOG = "[Service]\nWatchdogSec=6s\nRestartSec=1s\n"
EVERY_FEW_SECONDS = "[Timer]\nOnCalendar=\nOnCalendar=*-*-* *:*:0/5\nRandomizedDelaySec=0\nAccuracySec=1s\n"
SECRET = "a-token-of-the-plant-0123456789"  # noqa: S105
TRANSIENT = ("dev", "proc", "sys", "run", "tmp", "var/tmp", "var/log", "var/cache", "var/lib/dpkg", "var/lib/systemd")


def main() -> None:
    missing = [name for name in NEEDED if shutil.which(name) is None]
    if missing or os.geteuid() != 0:
        raise SystemExit(
            f"needs root and {', '.join(missing) or 'nothing else'}: apt-get install debootstrap systemd-container"
        )
    package = Path(sys.argv[1])
    depends = subprocess.run(
        ["dpkg-deb", "--field", str(package), "Depends"], check=True, stdout=subprocess.PIPE, text=True
    ).stdout  # fmt: skip
    began = time.monotonic()
    with booted_container(base_root(WORK, depends), WORK / "root", WORK / "console.log") as machine:
        shutil.copy(package, machine.root / "root/volcal.deb")
        found = PackageTrial(machine).walk()
    sys.stdout.write(json.dumps({**found, "seconds": round(time.monotonic() - began)}) + "\n")


class PackageTrial:
    """Actions of an administrator, in order; each step stores its observations in `seen`."""

    def __init__(self, machine: Container) -> None:
        self.machine = machine
        self.seen: dict[str, Any] = {}

    def walk(self) -> Mapping[str, Any]:
        before = self._files()
        for step in (
            self.install, self.start, self.calibrate, self.report, self.timer, self.decline, self.hang,
            self.credentials, self.upgrade_while_held, self.stop_while_held, self.upgrade, self.remove, self.purge,
        ):  # fmt: skip
            sys.stderr.write(f"{step.__name__}\n")
            try:
                step()
            except AssertionError:
                sys.stderr.write(self.machine.journal("volcal*")[-4000:] + "\n")
                raise
        self.seen["left_after_purge"] = left = sorted(self._files() - before)
        assert [path for path in left if path not in {"/etc/credstore", "/etc/.pwd.lock"}] == [], left
        return self.seen

    def install(self) -> None:
        machine = self.machine
        began = time.monotonic()
        said = machine.out("dpkg", "-i", "/root/volcal.deb")
        self.seen["install_s"] = round(time.monotonic() - began, 1)
        assert "write /etc/volcal/volcal.toml" in said, said
        assert machine.out("systemctl", "is-enabled", SERVICE) == "enabled"
        assert machine.run("systemctl", "is-enabled", TIMER, check=False).stdout.strip() == "disabled"
        assert machine.property(SERVICE, "ActiveState") == "inactive"
        assert "dialout" in machine.out("id", "volcal")
        assert "good" in machine.out("volcal", "config", "check", "/etc/volcal/volcal.toml.example")
        self._libraries_are_there()

    def _libraries_are_there(self) -> None:
        """Check that every library linked by the environment is part of this Debian or of the environment."""
        machine = self.machine
        linked = "find /usr/lib/volcal -name '*.so*' -type f | xargs -n1 ldd 2>/dev/null | awk '/not found/ {print $1}'"
        absent = set(machine.out("sh", "-c", linked).split())
        beside = machine.out("find", "/usr/lib/volcal", "-path", "*.libs/*", "-printf", "%f\n").split()
        assert absent <= set(beside), absent

    def start(self) -> None:
        machine = self.machine
        machine.run("systemctl", "start", SERVICE)
        assert machine.property(SERVICE, "ActiveState") == "inactive", "started without settings"
        start_simulator(machine)
        write_settings(self.machine, "")
        began = time.monotonic()
        machine.run("systemctl", "start", SERVICE)
        self.seen["ready_s"] = round(time.monotonic() - began, 1)
        assert machine.property(SERVICE, "ActiveState") == "active"
        self.seen["status_text"] = machine.property(SERVICE, "StatusText")
        assert self.seen["status_text"].startswith("case-study:")
        assert machine.out("stat", "-c", "%U %a", f"{STATE}/token", STATE) == "volcal 600\nvolcal 750"
        self._members_may_look_and_not_start()

    def _members_may_look_and_not_start(self) -> None:
        group = self.machine.out("id", "-g", "volcal")
        member = ("setpriv", "--reuid=65534", "--regid=65534", f"--groups={group}", "volcal")
        self.machine.run(*member, "status", "--config", SETTINGS)
        self.machine.run(*member, "abort", "--config", SETTINGS)
        start = self.machine.run(*member, "start", "--kind", "verify", "--config", SETTINGS, check=False)
        assert (start.returncode, "token cannot be read" in start.stderr) == (2, True), start.stderr

    def calibrate(self) -> None:
        began = time.monotonic()
        self.machine.run("volcal", "start", "--kind", "calibrate", "--consent", "--wait", "--config", SETTINGS)
        self.seen["calibrated_s"] = round(time.monotonic() - began, 1)
        assert self._status()["state"] == "complete"

    def report(self) -> None:
        """Write a report under the service's restrictions, on a Debian with only the package's dependencies."""
        allowed = ("User=volcal", "MemoryDenyWriteExecute=yes", "SystemCallFilter=@system-service")
        options = [word for one in allowed for word in ("-p", one)]
        command = ("volcal", "report", "last", "--pdf", "--config", SETTINGS)
        self.machine.run("systemd-run", "--quiet", "--wait", "--pipe", *options, *command)
        pages = self.machine.out("find", STATE, "-name", "report.pdf", "-size", "+10k")
        assert pages, "no report.pdf"

    def timer(self) -> None:
        """Check with the real timer and another calendar that a night is requested and carried out."""
        machine = self.machine
        machine.write(f"/etc/systemd/system/{TIMER}.d/often.conf", EVERY_FEW_SECONDS)
        machine.run("systemctl", "daemon-reload")
        machine.run("systemctl", "start", TIMER)
        wait_for(lambda: machine.property(NIGHTLY, "ActiveState") == "activating", "the timer to fire", 30.0)
        machine.run("systemctl", "stop", TIMER)
        wait_for(lambda: machine.property(NIGHTLY, "ActiveState") != "activating", "the night to end", PATIENCE_S)
        self.seen["night"] = self._last_run()
        assert self.seen["night"]["kind"] == "nightly", self.seen
        assert machine.property(NIGHTLY, "Result") == "success", machine.journal(NIGHTLY)

    def decline(self) -> None:
        """Check that nothing begins outside the permitted hours, and that this is not a failure."""
        hour = (int(self.machine.out("date", "+%H")) + 11) % 24
        runs = self._last_run()
        write_settings(self.machine, f'hours = ["{hour:02}:00-{hour:02}:30"]\n')
        self.machine.run("systemctl", "reload", SERVICE)
        self.machine.run("systemctl", "start", NIGHTLY)
        assert "nothing may begin by itself" in self.machine.journal(NIGHTLY)
        assert self.machine.property(NIGHTLY, "Result") == "success"
        asked = self.machine.run("volcal", "start", "--kind", "nightly", "--config", SETTINGS, check=False)
        self.seen["declined_exit"] = asked.returncode
        assert asked.returncode == DECLINED, asked.stderr
        assert self._last_run() == runs
        write_settings(self.machine, "")
        self.machine.run("systemctl", "reload", SERVICE)

    def hang(self) -> None:
        """Check that the watchdog restarts a stopped process."""
        machine = self.machine
        machine.write(f"/etc/systemd/system/{SERVICE}.d/watchdog.conf", QUICK_WATCHDOG)
        machine.run("systemctl", "daemon-reload")
        machine.run("systemctl", "restart", SERVICE)
        process = machine.property(SERVICE, "MainPID")
        began = time.monotonic()
        machine.run("sh", "-c", f"kill -STOP {process}")
        wait_for(lambda: machine.property(SERVICE, "NRestarts") == "1", "the watchdog", PATIENCE_S)
        wait_for(lambda: machine.property(SERVICE, "ActiveState") == "active", "the new process", PATIENCE_S)
        self.seen["hang_to_ready_s"] = round(time.monotonic() - began, 1)
        assert machine.property(SERVICE, "MainPID") != process
        assert "Watchdog timeout" in machine.journal(SERVICE)
        self.seen["stacks_in_the_journal"] = "most recent call first" in machine.journal(SERVICE)
        machine.run("rm", f"/etc/systemd/system/{SERVICE}.d/watchdog.conf")
        machine.run("systemctl", "daemon-reload")

    def credentials(self) -> None:
        """Check the administrator's token, which the night uses too; the service must also start
        without a panel code.
        """
        machine = self.machine
        machine.write("/etc/credstore/volcal.token", f"{SECRET}\n", 0o600)
        write_settings(self.machine, 'token_file = "/etc/credstore/volcal.token"\n')
        machine.run("systemctl", "restart", SERVICE)
        handed = machine.out("sh", "-c", f"stat -c '%a %U' /run/credentials/{SERVICE}/*")
        self.seen["credential_mode"] = handed
        machine.run("volcal", "reset", "--config", SETTINGS)
        assert "token" not in machine.journal(SERVICE).rpartition('"event":"serving"')[2]

    def upgrade_while_held(self) -> None:
        """Check that an upgrade does not interrupt a run, even one on hold."""
        machine = self.machine
        self._make_next()
        machine.run("volcal", "start", "--kind", "calibrate", "--consent", "--config", SETTINGS)
        wait_for(lambda: self._status()["touches"] > 0, "touches", PATIENCE_S)
        machine.run("volcal", "hold", "--config", SETTINGS)
        wait_for(lambda: self._status()["state"] == "held", "the hold", PATIENCE_S)
        process = machine.property(SERVICE, "MainPID")
        refused = machine.run("dpkg", "-i", "/root/next.deb", check=False)
        assert refused.returncode != 0
        assert "a run is under way" in refused.stderr, refused.stderr
        assert self._version() == self.seen.setdefault("version", self._version())
        assert machine.out("dpkg-query", "-W", "-f", "${db:Status-Status}", "volcal") == "installed"
        assert (self._status()["state"], machine.property(SERVICE, "MainPID")) == ("held", process)
        self.seen["upgrade_refused_while_held"] = True

    def stop_while_held(self) -> None:
        machine = self.machine
        began = time.monotonic()
        machine.run("systemctl", "stop", SERVICE)
        self.seen["stop_s"] = round(time.monotonic() - began, 1)
        assert machine.property(SERVICE, "Result") == "success", machine.journal(SERVICE)
        machine.run("systemctl", "start", SERVICE)
        status = self._status()
        assert status["state"] == "faulted", status
        assert "the service is being stopped" in status["alarms"][0]["text"], status
        machine.run("volcal", "reset", "--config", SETTINGS)

    def upgrade(self) -> None:
        """Check that an upgrade at rest stops, replaces and restarts the service with its state."""
        machine, former = self.machine, self._last_run()
        process = machine.property(SERVICE, "MainPID")
        machine.run("dpkg", "-i", "/root/next.deb")
        assert self._version() != self.seen["version"]
        assert machine.property(SERVICE, "ActiveState") == "active"
        assert machine.property(SERVICE, "MainPID") != process
        assert self._last_run() == former
        self.seen["upgraded_to"] = self._version()

    def remove(self) -> None:
        machine = self.machine
        machine.run("dpkg", "-r", "volcal")
        assert machine.out("find", "/proc", "-maxdepth", "1", "-user", "volcal") == ""
        assert not machine.exists("/usr/lib/volcal")
        assert machine.exists(f"{STATE}/token")
        assert machine.exists(SETTINGS)
        assert SERVICE not in machine.out(
            "systemctl", "list-units", "--all", "--no-legend", "volcal*", "--state=active"
        )
        self.seen["kept_on_remove"] = sorted(path.name for path in (machine.root / STATE.lstrip("/")).glob("*.*"))

    def purge(self) -> None:
        self.machine.run("dpkg", "-P", "volcal")
        for path in (STATE, "/etc/volcal", "/etc/credstore/volcal.token"):
            assert not self.machine.exists(path), path
        end_simulator(self.machine)

    def _status(self) -> dict[str, Any]:
        document: dict[str, Any] = json.loads(self.machine.out("volcal", "status", "--json", "--config", SETTINGS))
        return document

    def _last_run(self) -> dict[str, str]:
        status = self._status()
        return {"run": status["run_id"], "kind": status["kind"], "state": status["state"]}

    def _version(self) -> str:
        return self.machine.out("dpkg-query", "-W", "-f", "${Version}", "volcal")

    def _make_next(self) -> None:
        """Build the same package with a higher version."""
        tree = WORK / "next"
        shutil.rmtree(tree, ignore_errors=True)
        package = self.machine.root / "root/volcal.deb"
        subprocess.run(["dpkg-deb", "-R", str(package), str(tree)], check=True)
        control = tree / "DEBIAN/control"
        control.write_text(
            control.read_text().replace(f"Version: {self._version()}", f"Version: {self._version()}+next")
        )
        target = self.machine.root / "root/next.deb"
        command = ["dpkg-deb", "--root-owner-group", "-Znone", "-b", str(tree), str(target)]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        shutil.rmtree(tree)

    def _files(self) -> set[str]:
        """Return all files except transient ones."""
        found = self.machine.out("find", "/", "-xdev", "-not", "-path", "/root/*").splitlines()
        passing = tuple(f"/{folder}/" for folder in TRANSIENT)
        return {path for path in found if not path.startswith(passing)}


if __name__ == "__main__":
    main()
