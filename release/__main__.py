"""Command `make release`: the wheel, the Debian package, the pins and the bill of materials in one folder, with their
sums and a signature.

    python -m release --key PATH [--out dist/release]

The key is a private SSH key outside the checkout; `ssh-keygen -t ed25519 -f PATH` makes one. The checkout must be that
of a commit, and the audit of pins and licences must find nothing. A key in a hardware token or an agent is given by its
public part (`PATH.pub`). The output directory must be empty or contain a former release, which is replaced when the new
one is complete. The last line of the output is the public part of the key, to be published for the receivers by another
way than the files.
"""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from release.audit import findings
from release.deb import SBOM_IN_PACKAGE, build_deb
from release.errors import ReleaseRefused
from release.folder import replace_release, require_replaceable
from release.packages import ROOT, installed_packages
from release.pins import CONSTRAINTS
from release.sbom import write_sbom
from release.signature import allowed_signer, require_key_outside, sign, verify, write_sums
from release.source import commit_time, require_clean
from release.wheel import build_wheel


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--key", type=Path, required=True, help="SSH key that signs, outside the checkout")
    parser.add_argument("--out", type=Path, default=ROOT / "dist" / "release", help="output directory")
    given = parser.parse_args()
    try:
        make_release(given.key.expanduser(), given.out.expanduser().resolve())
    except ReleaseRefused as error:
        print(error, file=sys.stderr)
        return 1
    return 0


def make_release(key: Path, out: Path) -> None:
    """Make all release files in the folder `out` and sign them with `key`. Raises ReleaseRefused if the release would
    not be one of the commit and of its pins, if `out` contains anything but a former release, or if the signature
    cannot be verified."""
    require_key_outside(key, ROOT)
    signer = allowed_signer(key)
    require_replaceable(out, ROOT)
    require_clean(ROOT)
    installed = installed_packages()
    if found := findings(installed):
        raise ReleaseRefused("\n".join(found))
    time = commit_time(ROOT)
    made = ROOT / "build" / "release"
    shutil.rmtree(made, ignore_errors=True)
    made.mkdir(parents=True)
    build_wheel(ROOT, ROOT / "build" / "wheel", made, time)
    work = ROOT / "build" / "deb"
    build_deb(work, made, "1", time)
    sbom = write_sbom(made, installed, time)
    if sbom.read_text(encoding="utf-8") != (work / "tree" / SBOM_IN_PACKAGE).read_text(encoding="utf-8"):
        raise ReleaseRefused("the Debian package contains other packages than this environment: run `make setup`")
    shutil.copyfile(ROOT / CONSTRAINTS, made / CONSTRAINTS)
    sums = write_sums(made)
    sign(sums, key)
    signers = made.with_name("allowed_signers")
    signers.write_text(signer, encoding="utf-8")
    verify(sums, signers)
    replace_release(out, made)
    for path in sorted(out.iterdir()):
        print(path)
    print(f"public key, to be published by another way: {signer.strip()}")


if __name__ == "__main__":
    sys.exit(main())
