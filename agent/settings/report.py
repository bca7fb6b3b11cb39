"""Section `[report]` of the settings file."""

from __future__ import annotations

from typing import Literal

from twin.formats.toml_reading import StrictModel


class ReportSettings(StrictModel):
    """Report of a run. `language` is that of the report that is stored at the end of each run, and of `volcal report`
    and the page of a plant unless they are asked for another one."""

    language: Literal["en", "de"] = "en"
