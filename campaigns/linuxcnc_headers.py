"""Trial `python -m campaigns.linuxcnc_headers`: volcal's LinuxCNC components compiled against the LinuxCNC of another
Debian release.

The packages linuxcnc-uspace and linuxcnc-uspace-dev of the release are loaded from the signed Debian archive and
unpacked into a temporary directory; nothing is installed. The two realtime components are translated with the
`halcompile` of these packages and compiled against their headers, and so is the program that loads the tables. Nothing
is run: a component that compiles may still behave differently. The output ends with one line of JSON. The exit code is
0 if all three compile, and 77 if the packages or the tools cannot be had.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path

COMPONENTS = Path(__file__).resolve().parent.parent / "drivers" / "linuxcnc" / "components"
PACKAGES = ("linuxcnc-uspace", "linuxcnc-uspace-dev")
MODULES = ("volcal_eoffset", "volcal_kins")
ARCHIVE = "deb [signed-by=/usr/share/keyrings/debian-archive-keyring.gpg] http://deb.debian.org/debian {} main\n"
GCC = ("gcc", "-std=gnu11", "-Wall", "-Werror", "-fPIC", "-c", "-D_GNU_SOURCE", "-DUSPACE")
PYTHON = "/usr/bin/python3"
"""Python of the system, which has the parser that `halcompile` needs."""
TOOLS = ("apt-get", "dpkg-deb", "gcc", PYTHON)
TIMEOUT_S = 600.0
EXIT_NOT_RUN = 77


class StepFailed(Exception):
    """A command has failed; the text is the end of its output."""


def run(command: Sequence[str], directory: Path) -> None:
    done = subprocess.run(  # noqa: S603  fixed commands
        command, cwd=directory, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
    )
    if done.returncode:
        raise StepFailed(f"{' '.join(command[:3])} …: {(done.stdout + done.stderr)[-800:]}")


def fetched(release: str, work: Path) -> list[Path]:
    """Return the downloaded packages of `release`. Raises StepFailed if they cannot be had."""
    for folder in ("state/lists/partial", "cache/archives/partial"):
        (work / folder).mkdir(parents=True)
    (work / "sources.list").write_text(ARCHIVE.format(release), encoding="utf-8")
    options = [
        *("-o", f"Dir::Etc::SourceList={work}/sources.list", "-o", "Dir::Etc::SourceParts=/dev/null"),
        *("-o", f"Dir::State={work}/state", "-o", f"Dir::Cache={work}/cache", "-o", "APT::Sandbox::User=root"),
    ]
    run(["apt-get", *options, "update"], work)
    run(["apt-get", *options, "download", *PACKAGES], work)
    return sorted(work.glob("*.deb"))


def compile_all(unpacked: Path, work: Path) -> dict[str, str]:
    """Compile the components against the headers in `unpacked`. Return the complaint for each; it is empty if there is
    none."""
    shutil.copytree(COMPONENTS, work, dirs_exist_ok=True)
    include = (f"-I{unpacked}/usr/include/linuxcnc", "-I.")
    halcompile = (PYTHON, f"{unpacked}/usr/bin/halcompile", "--preprocess", "-o")
    jobs: dict[str, list[Sequence[str]]] = {
        name: [(*halcompile, f"{name}.c", f"{name}.comp"), (*GCC, "-DRTAPI", "-D__MODULE__", *include, f"{name}.c")]
        for name in MODULES
    }
    jobs["volcal_tables"] = [(*GCC, "-DULAPI", *include, "volcal_tables.c")]
    found = {}
    for name, commands in jobs.items():
        found[name] = ""
        try:
            for command in commands:
                run(command, work)
        except StepFailed as failed:
            found[name] = str(failed)
    return found


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(prog="python -m campaigns.linuxcnc_headers", description=(__doc__ or "").strip())
    parser.add_argument("--release", default="trixie", help="Debian release [trixie]")
    release = parser.parse_args(arguments).release
    lacking = [tool for tool in TOOLS if shutil.which(tool) is None]
    if lacking:
        print(f"not run: {', '.join(lacking)} not found", file=sys.stderr)
        return EXIT_NOT_RUN
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder)
        try:
            packages = fetched(release, work)
            for package in packages:
                run(["dpkg-deb", "-x", str(package), str(work / "unpacked")], work)
        except StepFailed as failed:
            print(f"not run: {failed}", file=sys.stderr)
            return EXIT_NOT_RUN
        found = compile_all(work / "unpacked", work / "build")
        versions = sorted({package.name.split("_")[1].replace("%3a", ":") for package in packages})
    for name, complaint in found.items():
        print(f"{name}: {complaint or 'compiled without a warning'}")
    print(json.dumps({"release": release, "versions": versions, "complaints": found}))
    return int(any(found.values()))


if __name__ == "__main__":
    sys.exit(main())
