"""Which events are sent to webhooks."""

from __future__ import annotations

from collections.abc import Mapping
from enum import StrEnum
from typing import Any

from skyfolio.api.flights.journal import Step
from skyfolio.api.flights.operation_views import ENDED


class Topic(StrEnum):
    """What receivers can ask for."""

    LOSS = "loss"
    """A UAV was declared lost, or left its operation: event `uav_lost`."""
    APPROVAL = "approval"
    """A new plan waits for approval, or was approved: event `incident`, step `proposed` or `approved`."""
    COMPLETION = "completion"
    """An operation has ended, however it did: event `operation`."""
    TEST = "test"
    """Asked for by `:test`; nothing has happened."""


KINDS = ("uav_lost", "incident", "operation")
_ENDED = {state.value for state in ENDED}


def topic_of(kind: str, data: Mapping[str, Any]) -> Topic | None:
    """Return the topic of an event; None for one that is not sent."""
    if kind == "uav_lost":
        return Topic.LOSS
    if kind == "incident" and data.get("step") in {Step.PROPOSED.value, Step.APPROVED.value}:
        return Topic.APPROVAL
    if kind == "operation" and data.get("state") in _ENDED:
        return Topic.COMPLETION
    return None
