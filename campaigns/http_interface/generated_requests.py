"""Requests that schemathesis generates for an operation of an OpenAPI document, and what is wrong with the answers."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from http import HTTPStatus
from typing import Any

import schemathesis
from hypothesis import HealthCheck, Phase, given, seed, settings
from hypothesis.errors import Unsatisfiable
from schemathesis.checks import CHECKS, load_all_checks
from schemathesis.core.failures import FailureGroup
from schemathesis.core.result import Err

TIMEOUT_S = 300.0
STREAM = "/api/events"
ABORT = "/api/abort"
REJECTION = "negative_data_rejection"
CHECKED = (
    *("not_a_server_error", "status_code_conformance", "content_type_conformance"),
    *("response_headers_conformance", "response_schema_conformance", REJECTION),
)
"""Checks of schemathesis. None says that a valid request must be accepted, since that depends on the state of the
machine, of which the document says nothing. An abort is accepted whatever its body."""
MAX_FAILURES = 5


@dataclass
class OperationCount:
    """Numbers of responses of an operation by status, and descriptions of those that were wrong."""

    name: str
    statuses: Counter[int] = field(default_factory=Counter)
    failures: list[str] = field(default_factory=list)

    def line(self) -> str:
        answers = ", ".join(f"{number} × {status}" for status, number in sorted(self.statuses.items()))
        return f"{self.name:40} {answers}{f'  {len(self.failures)} WRONG' if self.failures else ''}"


def operations_of(url: str) -> Iterator[Any]:
    """Yield the operations of the service at `url`, read from its own document. Raise InvalidSchema if it is wrong."""
    load_all_checks()
    schema = schemathesis.openapi.from_url(f"{url}/api/openapi.json", headers={})
    for found in schema.exclude(path=STREAM).get_all_operations():
        if isinstance(found, Err):
            raise found.err()
        yield found.ok()


@dataclass(frozen=True)
class RequestKind:
    """Kind of generated requests: `mode` says whether they are valid, `token` is the access token that they have, if
    any, and `path` has the values of the parameters in the path that are not generated."""

    mode: schemathesis.GenerationMode
    token: str | None
    path: Mapping[str, str] = field(default_factory=dict)


def try_operation(operation: Any, token: str, run_id: str, examples: int, drawn_from: int) -> OperationCount:
    """Send valid and invalid requests with and without `token`, `examples` of each of these four kinds; if the path
    names a run, as many for the run `run_id`, which there is."""
    count = OperationCount(f"{operation.method.upper()} {operation.path}")
    kinds = [RequestKind(mode, given) for mode in schemathesis.GenerationMode for given in (token, None)]
    if "{run_id}" in operation.path:
        kinds += [replace(kind, path={"run_id": run_id}) for kind in kinds]
    for kind in kinds:
        _send(operation, kind, count, examples, drawn_from)
    return count


def _send(operation: Any, kind: RequestKind, count: OperationCount, examples: int, drawn_from: int) -> None:
    unchecked = {REJECTION} if operation.path == ABORT else set()
    checks = [CHECKS.get_one(name) for name in CHECKED if name not in unchecked]
    secured = bool(operation.definition.raw.get("security"))
    valid = kind.mode is schemathesis.GenerationMode.POSITIVE

    # A failure is noted and not raised, so that hypothesis goes on and reduces nothing on a machine that moves.
    @seed(drawn_from)
    @settings(
        max_examples=examples,
        deadline=None,
        database=None,
        phases=[Phase.generate],
        suppress_health_check=list(HealthCheck),
    )
    @given(case=operation.as_strategy(generation_mode=kind.mode, path_parameters=dict(kind.path) or None))
    def one(case: Any) -> None:
        if len(count.failures) >= MAX_FAILURES:
            return
        own = case.headers.get("Authorization")  # an invalid one is what such a request tries
        if valid:
            case.headers.pop("Authorization", None)
            own = None
        headers = {"Authorization": f"Bearer {kind.token}"} if kind.token and own is None else {}
        response = case.call(headers=headers, timeout=TIMEOUT_S)
        count.statuses[response.status_code] += 1
        wrong = _complaint(case, response, checks, refused=secured and not headers)
        if wrong:
            sent = case.as_curl_command(headers={})
            count.failures.append(f"{count.name}: {wrong[:300]}; sent: {sent[:400]}")

    # An operation without parameters and body has no invalid requests.
    with suppress(Unsatisfiable):
        one()


def _complaint(case: Any, response: Any, checks: list[Any], *, refused: bool) -> str:
    if refused and response.status_code < HTTPStatus.BAD_REQUEST:
        return f"accepted without the token: {response.status_code}"
    try:
        case.validate_response(response, checks=checks)
    except FailureGroup as group:
        return " | ".join(str(failure) for failure in group.exceptions)
    return ""
