"""Python environment of the package: pinned dependencies, and no traces of the computer that built it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from urllib.parse import urlsplit

from packaging.utils import canonicalize_name

from release.licences import licence_of, read_licence_list
from release.packages import PROJECT, SHIPPED_EXTRAS, installed_packages
from release.pins import CONSTRAINTS
from release.wheel import build_wheel

PYTHON = f"python{sys.version_info.major}.{sys.version_info.minor}"
SITE = Path("/usr/lib/volcal/lib") / PYTHON / "site-packages"
TESTS_OF = ("matplotlib", "mpl_toolkits", "numpy", "pandas", "scipy")
PUBLIC_INDEX = "pypi.org"


def install(root: Path, work: Path, site: Path, time: int) -> None:
    """Install volcal from the tracked files below `root` and its dependencies into `site`. `work` is a folder for the
    build, and `time` the UTC time of the wheel's files in s since 1970.

    Raises SystemExit if a trace of the build computer remains.
    """
    wheel = build_wheel(root, work / "wheel", work / "wheels", time)
    wanted = f"{wheel}[{','.join(SHIPPED_EXTRAS)}]"
    _pip("install", "--no-compile", "--target", site, "--constraint", root / CONSTRAINTS, wanted, time=time)
    shutil.rmtree(site / "bin")
    for package in TESTS_OF:
        for folder in [path for path in (site / package).rglob("tests") if path.is_dir()]:
            shutil.rmtree(folder)
    for path in site.rglob("direct_url.json"):
        path.unlink()
    for record in site.glob("*.dist-info/RECORD"):
        _only_what_is_there(record, site)
    _refuse_traces(site, [str(root), str(work), *_hosts()])


def licences(site: Path) -> str:
    """Return one paragraph for each bundled package, in the form of Debian's copyright pages."""
    stated = read_licence_list().stated
    folders = {str(canonicalize_name(path.name.partition("-")[0])): path.name for path in site.glob("*.dist-info")}
    return "".join(
        f"\nBundled: {name} {package.version}\nLicence: {licence_of(package, stated) or 'see its metadata'}\n"
        f"Text: {SITE / folders[name]}\n"
        for name, package in installed_packages(site).items()
        if name != PROJECT
    )


def _pip(*words: str | Path, time: int) -> None:
    command = [sys.executable, "-m", "pip", "--quiet", "--disable-pip-version-check", *map(str, words)]
    subprocess.run(command, check=True, env={**os.environ, "SOURCE_DATE_EPOCH": str(time)})


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
