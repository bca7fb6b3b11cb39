"""Report and page of a plant in German: each text of the English page, told by the catalogue of sentences."""

from __future__ import annotations

import re
from html import escape, unescape
from typing import Final

from agent.language.sentences import Language, german, without_marks
from agent.results.run_verdict import VERDICTS

_STYLE: Final = re.compile(r"(<style[^>]*>.*?</style>)", re.DOTALL)
_TEXT: Final = re.compile(r">([^<]*\w[^<]*)<")
_ATTRIBUTE: Final = re.compile(r'(?<= )(aria-label|title|data-page|data-of|data-head)="([^"]*)"')
_SHARE: Final = re.compile(r"^(\d+) of (\d+)$")
_VERDICTS: Final = {words["en"]: words["de"] for verdict in VERDICTS for words in (verdict.word, verdict.sentence)}


def page_in_language(page: str, language: Language) -> str:
    """Return an HTML text in English, in which names may be marked (`agent.language.sentences.as_it_is`), in the
    language, with its numbers and times. The style, marked names, and what the catalogue does not have stay as they
    are; the marks are removed."""
    return without_marks(page if language == "en" else _in_german(page))


def _in_german(page: str) -> str:
    parts = _STYLE.split(page.replace('<html lang="en">', '<html lang="de">', 1))
    return "".join(part if part.startswith("<style") else _told(part) for part in parts)


def _told(part: str) -> str:
    named = _ATTRIBUTE.sub(lambda found: f'{found[1]}="{_german(found[2])}"', part)
    return _TEXT.sub(lambda found: f">{_german(found[1])}<", named)


def _german(text: str) -> str:
    """Return an escaped text in German, with the white space around it."""
    inner = text.strip()
    before, _, after = text.partition(inner)
    plain = unescape(inner)
    words = _VERDICTS.get(plain) or _SHARE.sub(r"\1 von \2", german(plain))
    return f"{before}{escape(words, quote=False)}{after}"
