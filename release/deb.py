"""Command `make deb`: the Debian package with its own environment. The same commit gives the same bytes.

    python -m release.deb [--revision 1] [--out dist]

The interpreter that runs this determines the package's Python version. Dependencies are those of constraints.txt.
"""

from __future__ import annotations

import argparse
import gzip
import os
import shutil
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from drivers.clock import wall_seconds
from release.deb_environment import PYTHON, SITE, install, licences
from release.errors import ReleaseRefused
from release.packages import PROJECT, ROOT, SHIPPED_EXTRAS, installed_packages, project_table, reached, required
from release.sbom import sbom_text
from release.source import PROGRAM, TEXT, commit_time, export_tracked

UNITS = ROOT / "systemd"
PARTS = UNITS / "deb"
SBOM_IN_PACKAGE = Path("usr/share/doc/volcal/sbom.cdx.json")
LAUNCHER = """#!/usr/lib/volcal/bin/python3 -sP
import sys
from agent.cli.main import main
sys.argv[0] = "volcal"
sys.exit(main())
"""
KIB = 1024


def run(*command: str | Path, cwd: Path | None = None, environment: Mapping[str, str] | None = None) -> str:
    words = [str(word) for word in command]
    told = {**os.environ, **(environment or {})}
    return subprocess.run(words, check=True, stdout=subprocess.PIPE, text=True, cwd=cwd, env=told).stdout


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--revision", default="1", help="package revision, appended to the program version")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="output directory")
    given = parser.parse_args()
    began = wall_seconds()
    try:
        package = build_deb(ROOT / "build" / "deb", given.out.resolve(), given.revision, commit_time(ROOT))
    except ReleaseRefused as error:
        print(error, file=sys.stderr)
        return 1
    size = package.stat().st_size / KIB**2
    print(f"{package}\n{size:.1f} MiB, built in {wall_seconds() - began:.0f} s")
    return 0


def build_deb(work: Path, out: Path, revision: str, time: int) -> Path:
    """Build the package in the folder `work` and return its path in the folder `out`. `time` is the UTC time of its
    files in s since 1970."""
    version = f"{project_table()['project']['version']}-{revision}"
    tree = work / "tree"
    shutil.rmtree(tree, ignore_errors=True)
    site = tree / SITE.relative_to("/")
    install(ROOT, work, site, time)
    lay_out(tree)
    put(tree / SBOM_IN_PACKAGE, site_sbom(site, time))
    describe(tree, site, version)
    return pack(tree, out, version, time)


def site_sbom(site: Path, time: int) -> str:
    """Return the bill of materials of the packages in `site`. `time` is its UTC time in s since 1970."""
    installed = installed_packages(site)
    requirements = required(project_table(), SHIPPED_EXTRAS)
    return sbom_text(installed[PROJECT], requirements, reached(requirements, installed), time)


def lay_out(tree: Path) -> None:
    """Install everything except the environment, the licences and the control files."""
    private = tree / "usr/lib/volcal"
    put(private / "bin/volcal", LAUNCHER, PROGRAM)
    (private / "bin/python3").symlink_to(f"/usr/bin/{PYTHON}")
    put(private / "pyvenv.cfg", f"home = /usr/bin\ninclude-system-site-packages = false\nversion = {PYTHON[6:]}\n")
    link(tree / "usr/bin/volcal", "../lib/volcal/bin/volcal")
    export_tracked(ROOT, tree / "usr/share/volcal", ("config",))
    for unit in ("volcal.service", "volcal-nightly.service", "volcal-nightly.timer"):
        put(tree / "usr/lib/systemd/system" / unit, (UNITS / unit).read_text())
    put(tree / "usr/lib/sysusers.d/volcal.conf", (UNITS / "volcal.sysusers").read_text())
    put(tree / "usr/lib/tmpfiles.d/volcal.conf", (UNITS / "volcal.tmpfiles").read_text())
    put(tree / "etc/volcal/volcal.toml.example", (PARTS / "volcal.toml.example").read_text())
    documents = tree / "usr/share/doc/volcal"
    export_tracked(ROOT, documents, ("docs",))
    for program in (documents / "docs").rglob("*.py"):
        program.unlink()
    for example in sorted((UNITS / "examples").glob("*.conf")):
        put(documents / "examples" / example.name, example.read_text())
    put(documents / "README.md", (ROOT / "README.md").read_text())
    put_compressed(documents / "changelog.gz", ROOT / "CHANGELOG.md")
    put_compressed(tree / "usr/share/man/man1/volcal.1.gz", PARTS / "volcal.1")


def describe(tree: Path, site: Path, version: str) -> None:
    """Write the copyright page and the control files."""
    copyright_page = (PARTS / "copyright").read_text() + licences(site)
    put(tree / "usr/share/doc/volcal/copyright", copyright_page)
    size = sum(path.stat().st_size for path in tree.rglob("*") if path.is_file() and not path.is_symlink())
    architecture = run("dpkg", "--print-architecture").strip()
    control = (PARTS / "control").read_text()
    fields = {"VERSION": version, "ARCHITECTURE": architecture, "SIZE": str(size // KIB), "PYTHON": PYTHON}
    for name, value in fields.items():
        control = control.replace(f"@{name}@", value)
    put(tree / "DEBIAN/control", control)
    put(tree / "DEBIAN/conffiles", "/etc/volcal/volcal.toml.example\n")
    for script in ("postinst", "prerm", "postrm"):
        put(tree / "DEBIAN" / script, (PARTS / script).read_text(), PROGRAM)
    files = sorted(path for path in tree.rglob("*") if path.is_file() and not path.is_symlink())
    sums = run("md5sum", *(path.relative_to(tree) for path in files if "DEBIAN" not in path.parts), cwd=tree)
    put(tree / "DEBIAN/md5sums", sums)


def pack(tree: Path, out: Path, version: str, time: int) -> Path:
    """Pack the tree with file modes and times that do not depend on the umask or the clock."""
    for path in (tree, *tree.rglob("*")):
        if not path.is_symlink():
            path.chmod(PROGRAM if path.is_dir() or path.stat().st_mode & 0o100 else TEXT)
        os.utime(path, (time, time), follow_symlinks=False)
    out.mkdir(parents=True, exist_ok=True)
    architecture = run("dpkg", "--print-architecture").strip()
    package = out / f"volcal_{version}_{architecture}.deb"
    # With two threads xz splits into blocks, which are the same on any computer.
    how = ("--root-owner-group", "-Zxz", "-z3", "--threads-max=2")
    run("dpkg-deb", *how, "--build", tree, package, environment={"SOURCE_DATE_EPOCH": str(time)})
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


if __name__ == "__main__":
    sys.exit(main())
