"""What integrators build on: codes of errors that the page lists, and operation ids that make good names."""

from __future__ import annotations

import re
from pathlib import Path

from skyfolio.api.common.settings import Settings
from skyfolio.api.http.app import create_app
from skyfolio.api.http.problems import TABLE

PAGE = (Path(__file__).resolve().parents[2] / "docs" / "api.md").read_text()


def test_the_page_lists_the_code_and_status_of_every_error() -> None:
    listed = re.findall(r"^\| `([a-z-]+)` \| (\d+|any) \|", PAGE.split("## Codes of errors")[1], re.MULTILINE)
    assert set(listed) == {(kind, str(status)) for status, kind, _ in TABLE.values()} | {("http", "any")}


def test_operation_ids_are_unique_names_of_what_is_done() -> None:
    paths = create_app(Settings()).openapi()["paths"]
    names = [operation["operationId"] for path in paths.values() for operation in path.values()]
    assert len(names) == len(set(names))
    assert all(re.fullmatch(r"[a-z]+(_[a-z]+)*", name) for name in names)
    assert {"create_plan", "start_operation", "register_webhook"} <= set(names)
