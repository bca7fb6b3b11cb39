"""HTTP application of the set-up of a new machine: the document of the page, and the endpoints that it uses.

What connects to the controller, keeps a statement or writes requires the token. The endpoints belong to the page and
may change with it; they are not part of the documented interface.
"""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, FastAPI, Response
from fastapi.responses import FileResponse
from pydantic import BaseModel, ConfigDict, StringConstraints

from agent.planning.new_machine.field import LONGEST_TEXT
from agent.planning.new_machine.fields import SETUP_FIELDS, STEPS, catalogue
from agent.service.http import problems
from agent.service.http.guard import Guard
from agent.service.http.permission import require_token
from agent.service.http.problems import DOCUMENTED
from agent.service.page.static_files import mount_document
from agent.service.setup.axis_check import Direction, Part
from agent.service.setup.session import SetupSession

Document = dict[str, Any]
DOCUMENT = "setup.html"
FieldName = Annotated[str, StringConstraints(max_length=40)]
FieldText = Annotated[str, StringConstraints(max_length=2 * LONGEST_TEXT)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class AnswersBody(_Body):
    """Texts of fields by name; an empty text withdraws a statement."""

    answers: dict[FieldName, FieldText]


class JogBody(_Body):
    axis: Literal["X", "Y", "Z"]


class SeenBody(_Body):
    """Motion that a person saw during a jog."""

    direction: Literal["as drawn", "opposite", "across"]
    part: Literal["tool", "workpiece"]


class TouchBody(_Body):
    by_hand: bool


def create_setup_app(session: SetupSession) -> FastAPI:
    """Return the HTTP application of one set-up."""
    app = FastAPI(title="volcal", openapi_url=None, docs_url=None, redoc_url=None)
    app.state.token = session.token
    app.add_middleware(Guard, names=())
    problems.install(app)
    app.include_router(_reading(session))
    app.include_router(_statements(session))
    mount_document(app, DOCUMENT)
    return app


def _reading(session: SetupSession) -> APIRouter:
    router = APIRouter(prefix="/api/setup", include_in_schema=False, responses=DOCUMENTED)

    @router.get("")
    def state() -> Document:
        """Return the whole state of the set-up."""
        return session.document()

    @router.get("/fields")
    def fields() -> Document:
        """Return the steps, their fields, and the words of the fields in both languages."""
        fields = [
            {"name": field.name, "step": field.step, "kind": field.kind.value, "choices": field.choices}
            for field in SETUP_FIELDS
        ]
        return {"steps": STEPS, "fields": fields, "words": catalogue()}

    @router.get("/look")
    def look() -> Document:
        """Return the axis positions of the connected controller, and the jog that is being watched."""
        return session.look()

    @router.get("/probe")
    def probe() -> Document:
        """Read the probe input of the connected controller once."""
        return {"finding": session.watch.look_at_probe().value}

    @router.get("/preview/{name}")
    def preview(name: str) -> Response:
        """Return a file of the preview of the plan."""
        path = session.preview(name)
        return Response(status_code=404) if path is None else FileResponse(path)

    return router


def _statements(session: SetupSession) -> APIRouter:
    router = APIRouter(
        prefix="/api/setup", include_in_schema=False, responses=DOCUMENTED, dependencies=[Depends(require_token)]
    )

    @router.post("/answers")
    def answers(body: AnswersBody) -> Document:
        """Take over the texts of fields."""
        return session.state(body.answers)

    @router.post("/connect")
    def connect() -> Document:
        """Connect to the controller and read what it reports."""
        return session.connect()

    @router.post("/jog")
    def jog(body: JogBody) -> Document:
        """Begin to watch the axis positions while a person jogs an axis."""
        return session.begin_jog(body.axis)

    @router.post("/seen")
    def seen(body: SeenBody) -> Document:
        """Keep what a person saw during the jog."""
        return session.judge_jog(Direction(body.direction), Part(body.part))

    @router.post("/touch")
    def touch() -> Document:
        """Begin to watch the probe input."""
        return {"finding": session.begin_touch().value}

    @router.post("/touched")
    def touched(body: TouchBody) -> Document:
        """Record whether a person has checked the probe input by hand."""
        return session.state_touch(by_hand=body.by_hand)

    @router.post("/review")
    def review() -> Document:
        """Prepare and check the files."""
        return session.review()

    @router.post("/write")
    def write() -> Document:
        """Write the reviewed files."""
        return session.write()

    @router.post("/finish")
    def finish() -> Document:
        """End the service of the set-up."""
        session.finished.set()
        return {"accepted": True}

    return router
