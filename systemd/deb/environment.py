"""Python environment of the package: pinned dependencies, and no traces of the computer that built it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from email.message import Message
from email.parser import HeaderParser
from pathlib import Path
from urllib.parse import urlsplit

PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
SITE = Path("/usr/lib/volcal/lib") / PYTHON / "site-packages"
SOURCES = (
    "agent",
    "config",
    "drivers",
    "gcode",
    "simulators",
    "twin",
    "volcal",
    "pyproject.toml",
    "README.md",
    "LICENSE",
)
EXTRAS = "opcua,postgres"
"""Optional dependencies that a plant may want for the service; a cluster for studies belongs on another computer."""
TESTS_OF = ("matplotlib", "mpl_toolkits", "numpy", "pandas", "scipy")
PUBLIC_INDEX = "pypi.org"


def install(root: Path, build: Path, site: Path) -> None:
    """Install volcal from the tracked files below `root` and its dependencies into `site`.

    Raises SystemExit if a trace of the build computer remains.
    """
    wheel = _wheel(root, build)
    _pip("install", "--no-compile", "--target", site, "--constraint", root / "constraints.txt", f"{wheel}[{EXTRAS}]")
    shutil.rmtree(site / "bin")
    for package in TESTS_OF:
        for folder in [path for path in (site / package).rglob("tests") if path.is_dir()]:
            shutil.rmtree(folder)
    for path in site.rglob("direct_url.json"):
        path.unlink()
    for record in site.glob("*.dist-info/RECORD"):
        _only_what_is_there(record, site)
    _refuse_traces(site, [str(root), str(build), *_hosts()])


def licences(site: Path) -> str:
    """Return one paragraph for each bundled package, in the form of Debian's copyright pages."""
    found = []
    for metadata in site.glob("*.dist-info/METADATA"):
        about = HeaderParser().parsestr(metadata.read_text(encoding="utf-8"))
        if about["Name"] != "volcal":
            found.append((about["Name"].lower(), about["Version"], _licence(about), metadata.parent.name))
    return "".join(
        f"\nBundled: {name} {version}\nLicence: {licence}\nText: {SITE / folder}\n"
        for name, version, licence, folder in sorted(found)
    )


def _licence(about: Message) -> str:
    headers = {name: about.get_all(name, []) for name in ("License-Expression", "Classifier", "License")}
    classified = [line.rpartition(" :: ")[2] for line in headers["Classifier"] if line.startswith("License ::")]
    free = [line.splitlines()[0] for line in headers["License"] if line]
    return "; ".join(headers["License-Expression"] or classified or free or ["see its metadata"])


def _wheel(root: Path, build: Path) -> Path:
    """Build the wheel from the files tracked by git, away from the checkout, whose leftovers
    setuptools would include.
    """
    source, wheels = build / "source", build / "wheels"
    for folder in (source, wheels):
        shutil.rmtree(folder, ignore_errors=True)
    listed = subprocess.run(
        ["git", "-C", str(root), "ls-files", "-z", *SOURCES],
        check=True, stdout=subprocess.PIPE, text=True,
    ).stdout  # fmt: skip
    for name in filter(None, listed.split("\0")):
        (source / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(root / name, source / name, follow_symlinks=False)  # volcal/config is a link to config/
    _pip("wheel", "--no-deps", "--wheel-dir", wheels, source)
    return next(wheels.glob("volcal-*.whl"))


def _pip(*words: str | Path) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *map(str, words)]
    subprocess.run(command, check=True)


def _only_what_is_there(record: Path, site: Path) -> None:
    lines = record.read_text(encoding="utf-8").splitlines()
    kept = [line for line in lines if (site / line.rsplit(",", 2)[0].strip('"')).exists()]
    record.write_text("".join(f"{line}\n" for line in kept), encoding="utf-8")


def _hosts() -> set[str]:
    """Return the hosts of the package indexes that pip uses on this computer, from its configuration or the
    environment.
    """
    told = subprocess.run(
        [sys.executable, "-m", "pip", "config", "list"],
        check=True, stdout=subprocess.PIPE, text=True,
    ).stdout  # fmt: skip
    told += " ".join(value for name, value in os.environ.items() if name.startswith("PIP_"))
    hosts = {urlsplit(url).hostname for url in re.findall(r"https?://[^\s'\"]+", told)}
    return {host for host in hosts if host and not host.endswith(PUBLIC_INDEX)}


def _refuse_traces(site: Path, traces: list[str]) -> None:
    for path in site.rglob("*"):
        if path.is_file():
            content = path.read_bytes()
            if found := [trace for trace in traces if trace.encode() in content]:
                raise SystemExit(f"{path} contains {found}, a trace of the build computer")
