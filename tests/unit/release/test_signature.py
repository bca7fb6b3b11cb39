"""Sums and signature of release files, verified with the tools that a receiver has."""

from __future__ import annotations

import subprocess
from pathlib import Path

import pytest

from release.errors import ReleaseRefused
from release.signature import (
    NAMESPACE,
    SIGNATURE,
    SUMS,
    allowed_signer,
    require_key_outside,
    sign,
    verify,
    write_sums,
)


def new_key(path: Path) -> Path:
    subprocess.run(["ssh-keygen", "-q", "-t", "ed25519", "-N", "", "-C", "", "-f", str(path)], check=True)
    return path


@pytest.fixture
def key(tmp_path: Path) -> Path:
    return new_key(tmp_path / "key")


@pytest.fixture
def release(tmp_path: Path, key: Path) -> Path:
    folder = tmp_path / "release"
    folder.mkdir()
    (folder / "volcal-0.1.0-py3-none-any.whl").write_bytes(b"a wheel")
    (folder / "constraints.txt").write_text("numpy==2.4.6\n")
    sign(write_sums(folder), key)
    return folder


@pytest.fixture
def signers(tmp_path: Path, key: Path) -> Path:
    path = tmp_path / "allowed_signers"
    path.write_text(allowed_signer(key))
    return path


def as_documented(folder: Path, signers: Path) -> bool:
    """Verify as the documentation says."""
    command = (
        f"ssh-keygen -Y verify -f {signers} -I volcal -n volcal-release -s SHA256SUMS.sig < SHA256SUMS"
        " && sha256sum --check --strict SHA256SUMS"
    )
    return subprocess.run(["sh", "-c", command], cwd=folder, capture_output=True, check=False).returncode == 0


def test_a_signed_release_is_verified_by_us_and_as_documented(release: Path, signers: Path) -> None:
    verify(release / SUMS, signers)
    assert as_documented(release, signers)
    names = [line.split("  ")[1] for line in (release / SUMS).read_text().splitlines()]
    assert names == ["constraints.txt", "volcal-0.1.0-py3-none-any.whl"]


def test_a_changed_file_is_found(release: Path, signers: Path) -> None:
    (release / "constraints.txt").write_text("numpy==2.4.7\n")
    with pytest.raises(ReleaseRefused, match=r"constraints\.txt was changed"):
        verify(release / SUMS, signers)
    assert not as_documented(release, signers)


def test_a_missing_file_is_found(release: Path, signers: Path) -> None:
    (release / "constraints.txt").unlink()
    with pytest.raises(ReleaseRefused, match=r"constraints\.txt is listed"):
        verify(release / SUMS, signers)
    assert not as_documented(release, signers)


def test_sums_that_were_made_anew_for_a_changed_file_are_not_signed(release: Path, signers: Path) -> None:
    (release / "constraints.txt").write_text("numpy==2.4.7\n")
    write_sums(release)
    with pytest.raises(ReleaseRefused, match="is not the signature"):
        verify(release / SUMS, signers)
    assert not as_documented(release, signers)


def test_the_signature_of_another_key_is_refused(release: Path, signers: Path, tmp_path: Path) -> None:
    sign(release / SUMS, new_key(tmp_path / "other"))
    with pytest.raises(ReleaseRefused, match="is not the signature"):
        verify(release / SUMS, signers)


def test_a_signature_for_another_purpose_is_refused(release: Path, signers: Path, key: Path) -> None:
    (release / SIGNATURE).unlink()
    command = ["ssh-keygen", "-Y", "sign", "-q", "-n", "git", "-f", str(key), str(release / SUMS)]
    subprocess.run(command, check=True, capture_output=True)
    assert NAMESPACE != "git"
    with pytest.raises(ReleaseRefused, match="is not the signature"):
        verify(release / SUMS, signers)


def test_a_file_that_is_no_key_does_not_sign(release: Path, tmp_path: Path) -> None:
    (tmp_path / "none").write_text("no key")
    with pytest.raises(ReleaseRefused, match="none does not sign"):
        sign(release / SUMS, tmp_path / "none")


def test_the_public_part_is_read_from_the_key_if_there_is_no_file_of_it(key: Path) -> None:
    with_file = allowed_signer(key)
    key.with_name("key.pub").unlink()
    assert allowed_signer(key) == with_file
    assert with_file.startswith('volcal namespaces="volcal-release" ssh-ed25519 ')


def test_a_key_that_is_given_by_its_public_part_is_its_own_signer(key: Path) -> None:
    assert allowed_signer(key.with_name("key.pub")) == allowed_signer(key)


@pytest.mark.parametrize("text", ["", "no", "no key"])
def test_a_file_that_is_no_public_part_is_refused(text: str, tmp_path: Path) -> None:
    (tmp_path / "none.pub").write_text(text)
    with pytest.raises(ReleaseRefused, match=r"none\.pub is not the public part of a key"):
        allowed_signer(tmp_path / "none.pub")


def test_a_key_in_the_checkout_is_refused(key: Path, tmp_path: Path) -> None:
    require_key_outside(key, tmp_path / "checkout")
    with pytest.raises(ReleaseRefused, match="lies in the checkout"):
        require_key_outside(key, tmp_path)
    link = tmp_path.parent / f"{tmp_path.name}-link"
    link.symlink_to(key)
    with pytest.raises(ReleaseRefused, match="lies in the checkout"):
        require_key_outside(link, tmp_path)
    link.unlink()


@pytest.mark.parametrize("path", ["", "missing"])
def test_a_missing_key_is_said(path: str, tmp_path: Path) -> None:
    with pytest.raises(ReleaseRefused, match="there is no key"):
        require_key_outside(Path(path), tmp_path)
