"""Command `make deb`: the Debian package with its own environment; same sources and date give the same bytes.

The interpreter that runs this determines the package's Python version. Dependencies are those of constraints.txt.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shutil
import subprocess
import sys
import time
import tomllib
from pathlib import Path

from environment import PYTHON, SITE, install, licences

HERE = Path(__file__).resolve().parent
UNITS = HERE.parent
ROOT = UNITS.parent
BUILD = ROOT / "build" / "deb"
LAUNCHER = """#!/usr/lib/volcal/bin/python3 -sP
import sys
from agent.cli.main import main
sys.argv[0] = "volcal"
sys.exit(main())
"""
TEXT, PROGRAM = 0o644, 0o755
KIB = 1024


def run(*command: str | Path, cwd: Path | None = None) -> str:
    words = [str(word) for word in command]
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True, cwd=cwd).stdout


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--revision", default="1", help="package revision, appended to the program version")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="output directory")
    arguments = parser.parse_args()
    revision, out = arguments.revision, arguments.out.resolve()
    began = time.monotonic()
    version = f"{tomllib.loads((ROOT / 'pyproject.toml').read_text())['project']['version']}-{revision}"
    date = int(os.environ.get("SOURCE_DATE_EPOCH") or run("git", "-C", ROOT, "log", "-1", "--format=%ct"))
    os.environ["SOURCE_DATE_EPOCH"] = str(date)
    tree = BUILD / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    site = tree / SITE.relative_to("/")
    install(ROOT, BUILD, site)
    lay_out(tree)
    describe(tree, site, version)
    package = pack(tree, out, version, date)
    size = package.stat().st_size / KIB**2
    sys.stdout.write(f"{package}\n{size:.1f} MiB, built in {time.monotonic() - began:.0f} s\n")


def lay_out(tree: Path) -> None:
    """Install everything except the environment, the licences and the control files."""
    private = tree / "usr/lib/volcal"
    put(private / "bin/volcal", LAUNCHER, PROGRAM)
    (private / "bin/python3").symlink_to(f"/usr/bin/{PYTHON}")
    put(private / "pyvenv.cfg", f"home = /usr/bin\ninclude-system-site-packages = false\nversion = {PYTHON[6:]}\n")
    link(tree / "usr/bin/volcal", "../lib/volcal/bin/volcal")
    copy(ROOT / "config", tree / "usr/share/volcal/config")
    for unit in ("volcal.service", "volcal-nightly.service", "volcal-nightly.timer"):
        put(tree / "usr/lib/systemd/system" / unit, (UNITS / unit).read_text())
    put(tree / "usr/lib/sysusers.d/volcal.conf", (UNITS / "volcal.sysusers").read_text())
    put(tree / "usr/lib/tmpfiles.d/volcal.conf", (UNITS / "volcal.tmpfiles").read_text())
    put(tree / "etc/volcal/volcal.toml.example", (HERE / "volcal.toml.example").read_text())
    documents = tree / "usr/share/doc/volcal"
    copy(ROOT / "docs", documents / "docs")
    copy(UNITS / "examples", documents / "examples")
    put(documents / "README.md", (ROOT / "README.md").read_text())
    put_compressed(documents / "changelog.gz", ROOT / "CHANGELOG.md")
    put_compressed(tree / "usr/share/man/man1/volcal.1.gz", HERE / "volcal.1")


def describe(tree: Path, site: Path, version: str) -> None:
    """Write the copyright page and the control files."""
    copyright_page = (HERE / "copyright").read_text() + licences(site)
    put(tree / "usr/share/doc/volcal/copyright", copyright_page)
    size = sum(path.stat().st_size for path in tree.rglob("*") if path.is_file() and not path.is_symlink())
    architecture = run("dpkg", "--print-architecture").strip()
    control = (HERE / "control").read_text()
    fields = {"VERSION": version, "ARCHITECTURE": architecture, "SIZE": str(size // KIB), "PYTHON": PYTHON}
    for name, value in fields.items():
        control = control.replace(f"@{name}@", value)
    put(tree / "DEBIAN/control", control)
    put(tree / "DEBIAN/conffiles", "/etc/volcal/volcal.toml.example\n")
    for script in ("postinst", "prerm", "postrm"):
        put(tree / "DEBIAN" / script, (HERE / script).read_text(), PROGRAM)
    files = sorted(path for path in tree.rglob("*") if path.is_file() and not path.is_symlink())
    sums = run("md5sum", *(path.relative_to(tree) for path in files if "DEBIAN" not in path.parts), cwd=tree)
    put(tree / "DEBIAN/md5sums", sums)


def pack(tree: Path, out: Path, version: str, date: int) -> Path:
    """Build the package with file modes and times that do not depend on the umask or the clock."""
    for path in (tree, *tree.rglob("*")):
        if not path.is_symlink():
            path.chmod(PROGRAM if path.is_dir() or path.stat().st_mode & 0o100 else TEXT)
        os.utime(path, (date, date), follow_symlinks=False)
    out.mkdir(parents=True, exist_ok=True)
    architecture = run("dpkg", "--print-architecture").strip()
    package = out / f"volcal_{version}_{architecture}.deb"
    # With two threads xz splits into blocks, which are the same on any computer.
    run("dpkg-deb", "--root-owner-group", "-Zxz", "-z3", "--threads-max=2", "--build", tree, package)
    return package


def put(path: Path, text: str, mode: int = TEXT) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    path.chmod(mode)


def put_compressed(path: Path, source: Path) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(gzip.compress(source.read_bytes(), mtime=0))


def link(path: Path, target: str) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.symlink_to(target)


def copy(source: Path, target: Path) -> None:
    shutil.copytree(source, target, ignore=shutil.ignore_patterns("__pycache__", "*.py"))


if __name__ == "__main__":
    main()
