"""Tests that the committed description of the HTTP interface matches the code."""

from __future__ import annotations

import json
from pathlib import Path

from agent.service.http.description import openapi_document

COMMITTED = Path(__file__).resolve().parents[2] / "docs" / "reference" / "openapi.json"


def test_the_committed_document_matches_the_application() -> None:
    """Regenerate it with `python -m agent.service.http.description > docs/reference/openapi.json`."""
    assert json.loads(COMMITTED.read_text(encoding="utf-8")) == openapi_document()


def test_commands_need_a_token_except_abort_and_pairing() -> None:
    paths = openapi_document()["paths"]
    posts = {path: entry["post"] for path, entry in paths.items() if "post" in entry}
    guarded = {path for path, entry in posts.items() if entry.get("security")}
    assert set(posts) - guarded == {"/api/abort", "/api/pair"}
    reading = {path for path, entry in paths.items() if "get" in entry and entry["get"].get("security")}
    assert reading == {"/api/diagnostics", "/api/access", "/api/pairing/clients"}


def test_the_reason_of_an_abort_is_documented() -> None:
    body = openapi_document()["paths"]["/api/abort"]["post"]["requestBody"]
    assert not body.get("required", False)
    schema = body["content"]["application/json"]["schema"]
    assert set(schema["properties"]) == {"reason"}
    assert "required" not in schema


def test_the_reference_page_names_every_path() -> None:
    text = COMMITTED.with_name("http.md").read_text(encoding="utf-8")
    parts = [path.rpartition("/")[2] for path in openapi_document()["paths"]]
    assert [part for part in parts if part not in text] == []


def test_problem_documents_have_their_media_type() -> None:
    for path, entry in openapi_document()["paths"].items():
        for operation in entry.values():
            assert list(operation["responses"]["4XX"]["content"]) == ["application/problem+json"], path
