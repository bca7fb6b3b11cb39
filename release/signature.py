"""Sums of release files and their signature, with tools that every Debian has: sha256sum and ssh-keygen.

The signature is one of SSH (`ssh-keygen -Y sign`, PROTOCOL.sshsig of OpenSSH), in a namespace of its own, so that
nothing else that was signed with the key can pass for a release.
"""

from __future__ import annotations

import shutil
import subprocess
from hashlib import file_digest
from pathlib import Path

from release.errors import ReleaseRefused

SUMS = "SHA256SUMS"
SIGNATURE = f"{SUMS}.sig"
NAMESPACE = "volcal-release"
SIGNER = "volcal"
"""Name of the signer in the file of allowed signers."""


def write_sums(folder: Path) -> Path:
    """Write the SHA-256 sum of each file in `folder` in the format of sha256sum, sorted by name; return the path."""
    sums = folder / SUMS
    names = sorted(path.name for path in folder.iterdir() if path.name not in (SUMS, SIGNATURE))
    sums.write_text("".join(f"{_sum(folder / name)}  {name}\n" for name in names), encoding="utf-8")
    return sums


def sign(sums: Path, key: Path) -> Path:
    """Sign the file of sums with the private SSH key in the file `key`; return the path of the signature.

    ssh-keygen asks for a passphrase if the key has one; a key in a hardware token or an agent works by its public
    part. Raises ReleaseRefused if it does not sign.
    """
    signature = sums.with_name(SIGNATURE)
    signature.unlink(missing_ok=True)
    _ssh_keygen("-Y", "sign", "-q", "-n", NAMESPACE, "-f", str(key), str(sums), what=f"{key} does not sign")
    return signature


def verify(sums: Path, allowed_signers: Path) -> None:
    """Raise ReleaseRefused unless the sums carry the signature of an allowed signer and every file has its sum.

    This does what the documentation tells a receiver to do.
    """
    signature = sums.with_name(SIGNATURE)
    _ssh_keygen(
        *("-Y", "verify", "-q", "-f", str(allowed_signers), "-I", SIGNER, "-n", NAMESPACE, "-s", str(signature)),
        stdin=sums.read_bytes(),
        what=f"{signature} is not the signature of {sums.name} by a signer in {allowed_signers}",
    )
    for line in sums.read_text(encoding="utf-8").splitlines():
        stated, name = line.split("  ", 1)
        path = sums.with_name(name)
        if not path.is_file():
            raise ReleaseRefused(f"{name} is listed in {sums} but missing")
        if _sum(path) != stated:
            raise ReleaseRefused(f"{path} was changed: its SHA-256 sum is not the one in {sums.name}")


def allowed_signer(key: Path) -> str:
    """Return the line of a file of allowed signers for the key in the file `key`, which is the public part itself
    (`.pub`), has it beside it or contains it. Raises ReleaseRefused if there is no public part."""
    stated = key if key.suffix == ".pub" else key.with_name(f"{key.name}.pub")
    if stated.exists():
        _ssh_keygen("-l", "-f", str(stated), what=f"{stated} is not the public part of a key")
        public = stated.read_text(encoding="utf-8")
    else:
        public = _ssh_keygen("-y", "-f", str(key), what=f"{key} has no public part")
    kind, content = public.split()[:2]
    return f'{SIGNER} namespaces="{NAMESPACE}" {kind} {content}\n'


def require_key_outside(key: Path, root: Path) -> None:
    """Raise ReleaseRefused if there is no key at this path, or if it lies in the checkout, where it could be
    committed."""
    if not key.is_file():
        raise ReleaseRefused(f"there is no key {key}; make one with `ssh-keygen -t ed25519 -f PATH`")
    if key.resolve().is_relative_to(root.resolve()):
        raise ReleaseRefused(f"the key {key} lies in the checkout, where it could be committed; move it elsewhere")


def _sum(path: Path) -> str:
    with path.open("rb") as content:
        return file_digest(content, "sha256").hexdigest()


def _ssh_keygen(*words: str, what: str, stdin: bytes | None = None) -> str:
    command = shutil.which("ssh-keygen")
    if command is None:
        raise ReleaseRefused("ssh-keygen is missing: apt-get install openssh-client")
    done = subprocess.run([command, *words], check=False, input=stdin, capture_output=True)
    if done.returncode != 0:
        said = (done.stderr or done.stdout).decode(errors="replace").strip()
        raise ReleaseRefused(f"{what}: {said}")
    return done.stdout.decode()
