"""Figure that a notebook shows as a picture if it is the last value of a cell, also without a plotting backend."""

from __future__ import annotations

import io

from matplotlib.figure import Figure

DOTS_PER_INCH = 110.0


class NotebookFigure(Figure):
    """Figure of matplotlib with the picture that a notebook asks for."""

    def png(self) -> bytes:
        """Return the figure as a PNG picture."""
        stream = io.BytesIO()
        self.savefig(stream, format="png", dpi=DOTS_PER_INCH)
        return stream.getvalue()

    def _repr_png_(self) -> bytes:
        return self.png()
