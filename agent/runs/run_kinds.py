"""Kinds of runs that can be requested. The names are not in the module of the request, so that the command line can
offer them without importing the library that validates requests.
"""

from __future__ import annotations

from typing import Literal, get_args

KindName = Literal["calibrate", "verify", "nightly"]
KINDS: tuple[KindName, ...] = get_args(KindName)
