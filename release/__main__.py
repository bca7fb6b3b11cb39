"""Command `make release`: the wheel, the Debian package, the pins and the bill of materials in one folder, with their
sums and a signature.

    python -m release --key PATH [--out dist/release]

The key is a private SSH key outside the checkout; `ssh-keygen -t ed25519 -f PATH` makes one. The checkout must be that
of a commit, and the audit of pins and licences must find nothing. The last line of the output is the public part of the
key, to be published for the receivers by another way than the files.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from release.audit import findings
from release.deb import SBOM_IN_PACKAGE, build_deb
from release.errors import ReleaseRefused
from release.packages import ROOT, installed_packages
from release.pins import CONSTRAINTS
from release.sbom import write_sbom
from release.signature import allowed_signer, require_key_outside, sign, verify, write_sums
from release.source import commit_time, require_clean
from release.wheel import build_wheel


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--key", type=Path, required=True, help="private SSH key that signs, outside the checkout")
    parser.add_argument("--out", type=Path, default=ROOT / "dist" / "release", help="output directory, made anew")
    given = parser.parse_args()
    try:
        make_release(given.key, given.out.resolve())
    except ReleaseRefused as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def make_release(key: Path, out: Path) -> None:
    """Make all release files in the folder `out` and sign them with `key`. Raises ReleaseRefused if the release would
    not be one of the commit and of its pins, or if the signature cannot be verified."""
    require_key_outside(key, ROOT)
    require_clean(ROOT)
    installed = installed_packages()
    if found := findings(installed):
        raise ReleaseRefused("\n".join(found))
    time = commit_time(ROOT)
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    build_wheel(ROOT, ROOT / "build" / "wheel", out, time)
    work = ROOT / "build" / "deb"
    build_deb(work, out, "1", time)
    sbom = write_sbom(out, installed, time)
    if sbom.read_text(encoding="utf-8") != (work / "tree" / SBOM_IN_PACKAGE).read_text(encoding="utf-8"):
        raise ReleaseRefused("the Debian package contains other packages than this environment: run `make setup`")
    shutil.copyfile(ROOT / CONSTRAINTS, out / CONSTRAINTS)
    sums = write_sums(out)
    sign(sums, key)
    signers = out.with_name("allowed_signers")
    signers.write_text(allowed_signer(key), encoding="utf-8")
    verify(sums, signers)
    for path in sorted(out.iterdir()):
        print(path)
    print(f"public key, to be published by another way: {signers.read_text(encoding='utf-8').strip()}")


if __name__ == "__main__":
    sys.exit(main())
