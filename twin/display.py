"""Display of values in notebooks.

A notebook asks the last value of a cell for HTML. What draws it needs matplotlib and stands above this package, so a
library that can draw registers itself here.
"""

from __future__ import annotations

from collections.abc import Callable

Renderer = Callable[[object], str | None]
_RENDERERS: list[Renderer] = []


def render_with(renderer: Renderer) -> None:
    """Use `renderer` to turn values into HTML. It returns None for a value that it cannot show."""
    _RENDERERS[:] = [renderer]


class Displayed:
    """Value that a notebook shows as HTML if a renderer is registered, and by its short representation otherwise."""

    __slots__ = ()

    def _repr_html_(self) -> str | None:
        return _RENDERERS[0](self) if _RENDERERS else None
