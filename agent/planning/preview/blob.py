"""Preview of a plan as one compact JSON text for the interactive page. Lengths are in tenths of a millimetre and times
in hundredths of a second, both as integers.

The path of the stylus tip is stored as differences between consecutive points, because the text of ten thousand points
is then short. The differences are taken between rounded values, so rounding errors do not add up.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from itertools import groupby, pairwise

from agent.planning.preview.scene import ArtefactPlacement, PathPoint, Preview, Refusal, Visit
from agent.probing.run_plan import position_key
from twin.collision.bodies import Body
from twin.collision.geometry import Box, Capsule

PER_MM = 10
PER_S = 100
NO_BALL = -1


def embedded(preview: Preview) -> str:
    """Return `preview` as JSON text that can be embedded in a `<script>` element of an HTML page.

    The text contains no character ``<`` and therefore cannot end the element.
    """
    text = json.dumps(document(preview), separators=(",", ":"), ensure_ascii=True, allow_nan=False)
    return text.replace("<", "\\u003c")


def document(preview: Preview) -> dict[str, object]:
    names = sorted({body.name for placement in preview.placements for body in placement.bodies})
    return {
        "machine": preview.machine,
        "artefact": preview.artefact,
        "set": preview.position_set,
        "minutes": round(preview.minutes, 2),
        "balls": preview.balls,
        "unreachable": preview.unreachable,
        "travel": _box(preview.travel),
        "table": _box(preview.table),
        "probe": [_body(body) for body in preview.probe],
        "names": names,
        "placings": [_placing(placement, names) for placement in preview.placements],
        "visits": [_visit(visit) for visit in preview.visits],
        "path": _path(preview.path),
        "refusal": _refusal(preview.refusal),
    }


def _placing(placement: ArtefactPlacement, names: Sequence[str]) -> dict[str, object]:
    index = {name: number for number, name in enumerate(names)}
    position = placement.position
    return {
        "key": position_key(position),
        "station": position.station,
        "az": position.azimuth_deg,
        "el": position.elevation_deg,
        "heldOut": placement.held_out,
        "reachable": placement.reachable,
        "balls": [[*_tenths(ball.centre_mm), ball.obstruction] for ball in placement.balls],
        "bodies": [[index[body.name], *_capsule(body)] for body in placement.bodies],
    }


def _visit(visit: Visit) -> list[object]:
    return [visit.phase, visit.placement, visit.first, visit.end, visit.note]


def _path(path: Sequence[PathPoint]) -> dict[str, object]:
    tips = [_tenths(point.tip_mm) for point in path]
    seconds = [round(PER_S * point.ends_s) for point in path]
    steps = [[b - a for a, b in zip(one, other, strict=True)] for one, other in pairwise([[0, 0, 0], *tips])]
    balls = groupby(NO_BALL if point.ball is None else point.ball for point in path)
    return {
        "steps": [value for step in steps for value in step],
        "times": [b - a for a, b in pairwise([0, *seconds])],
        "touches": "".join("1" if point.touch else "0" for point in path),
        "balls": [[ball, sum(1 for _ in run)] for ball, run in balls],
    }


def _refusal(refusal: Refusal | None) -> dict[str, object] | None:
    if refusal is None:
        return None
    return {
        "message": refusal.message,
        "step": refusal.step,
        "bodies": list(refusal.bodies),
        "tip": _tenths(refusal.tip_mm),
        "visit": refusal.visit,
    }


def _body(body: Body) -> list[object]:
    """Return name and lower and upper corner of a box, or name, both ends and radius of a capsule."""
    return [body.name, *(_box(body.shape) if isinstance(body.shape, Box) else _capsule(body))]


def _box(box: Box) -> list[int]:
    return [*_tenths(box.lower), *_tenths(box.upper)]


def _capsule(body: Body) -> list[int]:
    shape = body.shape
    if not isinstance(shape, Capsule):
        raise TypeError(f"{body.name} is not a capsule")
    return [*_tenths(shape.a), *_tenths(shape.b), *_tenths([shape.radius])]


def _tenths(values_mm: Iterable[float]) -> list[int]:
    return [round(PER_MM * value) for value in values_mm]
