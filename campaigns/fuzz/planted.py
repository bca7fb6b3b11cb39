"""Decoder with a defect that lies behind four bytes, by which the search along branches is tested: one mutation in
2³² would find it blindly."""

from __future__ import annotations

from collections.abc import Iterator

from campaigns.fuzz.trial import Decoder

SIGN = b"#q7!"


def decoders() -> Iterator[Decoder]:
    yield Decoder("planted", [b"a good input"], _decode)
    yield Decoder("good", [b"a good input"], len, share=0.01)


def _decode(data: bytes) -> None:
    if data[0:1] == SIGN[0:1]:  # noqa: SIM102  each comparison is a branch of its own
        if data[1:2] == SIGN[1:2]:  # noqa: SIM102
            if data[2:3] == SIGN[2:3]:  # noqa: SIM102
                if data[3:4] == SIGN[3:4]:
                    raise KeyError("planted")
