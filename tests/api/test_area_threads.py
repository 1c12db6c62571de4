"""Areas planned at the same time: order, stopping, failures; and who uses them."""

from __future__ import annotations

import json
import os
import sys
import threading
from dataclasses import dataclass, field
from typing import Any

import pytest

from skyfolio.api.cli import main as cli
from skyfolio.api.plans.area_threads import AreaThreads, interrupting
from skyfolio.api.plans.job_board import Board
from skyfolio.api.plans.jobs import Job
from skyfolio.api.plans.solving import attempt, starts_of
from skyfolio.planner import AnyOf, Iteration, MaxIterations, Plan, PlanStatus, StopToken, plan, violations
from skyfolio.planner.areas import size
from skyfolio.planner.layouts import laid_out
from skyfolio.planner.stopping import StoppingRule


@dataclass
class Waiting:
    """A task that ends after another one has begun, or once it is asked to stop."""

    name: str
    begun: threading.Event = field(default_factory=threading.Event)
    after: threading.Event | None = None

    def run(self, stop: StoppingRule) -> str:
        self.begun.set()
        while self.after is not None and not self.after.wait(0.01):
            if stop([]):
                return f"{self.name} stopped"
        return self.name


class Failing:
    """A task that raises."""

    def run(self, stop: StoppingRule) -> Any:  # noqa: ARG002
        raise ValueError("no such place")


def test_what_tasks_find_comes_in_their_order_whichever_ends_first() -> None:
    last = Waiting("last")
    told: list[int] = []
    with AreaThreads(at_once=2, told=told.append) as run_areas:
        assert run_areas([Waiting("first", after=last.begun), last]) == ["first", "last"]
        assert run_areas([]) == []
    assert told[-1] == 2


def test_tasks_are_asked_to_stop_when_the_plan_is() -> None:
    never = threading.Event()
    with AreaThreads(lambda: True, at_once=2) as run_areas:
        found = run_areas([Waiting("a", after=never), Waiting("b", after=never), Waiting("c", after=never)])
    assert found == ["a stopped", "b stopped", "c stopped"]


def test_what_a_task_raises_is_raised_to_who_plans_and_ends_the_others() -> None:
    with AreaThreads(at_once=2) as run_areas, pytest.raises(ValueError, match="no such place"):
        run_areas([Failing(), Waiting("b", after=threading.Event())])


class Priority:
    """A task that tells how nice its thread is."""

    def run(self, stop: StoppingRule) -> int:  # noqa: ARG002
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())


@pytest.mark.skipif(sys.platform != "linux", reason="only there has each thread a priority of its own")
def test_threads_stand_back_as_far_as_they_are_told_and_who_plans_does_not() -> None:
    own = os.getpriority(os.PRIO_PROCESS, 0)
    with AreaThreads(niceness=3) as nice, AreaThreads() as not_nice:
        assert nice([Priority()]) == [min(own + 3, 19)]
        assert not_nice([Priority()]) == [own]
    assert os.getpriority(os.PRIO_PROCESS, 0) == own


def test_only_rules_that_interrupt_stop_tasks() -> None:
    assert not interrupting(AnyOf(MaxIterations(1)))()
    assert interrupting(AnyOf(MaxIterations(1), StopToken(lambda: True)))()


class Nowhere(Board):
    """A board that counts what is noted."""

    noted = 0

    def stopped(self, token: int) -> bool:  # noqa: ARG002
        return False

    def note(self, token: int, iteration: Iteration) -> None:  # noqa: ARG002
        self.noted += 1

    def show(self, token: int, plan: str) -> None:
        pass


@pytest.fixture
def everything_is_large(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(size, "MOST_AT_ONCE", 100)


@pytest.mark.usefixtures("everything_is_large")
def test_a_worker_plans_and_replans_large_fleets_by_areas_as_one_thread_would() -> None:
    scenario = laid_out("uniform", 20, 60, 6, seed=1)
    board = Nowhere()
    assert starts_of(scenario, 24) is None
    solved = attempt(Job(scenario=scenario.model_dump_json(), identity={"id": "plan-1"}), board, 0)
    assert solved.status is PlanStatus.SUCCEEDED, solved.error
    made = Plan.model_validate_json(solved.plan)
    alone = plan(scenario)
    assert made.method == alone.method == "areas"
    assert made.trajectories_m == alone.trajectories_m
    assert board.noted == len(made.history)
    request = {"failed": ["uav-3"], "at_slot": 2}
    again = attempt(Job(previous=solved.plan, request=request, identity={"id": "plan-2"}), board, 0)
    assert again.status is PlanStatus.SUCCEEDED, again.error
    assert violations(Plan.model_validate_json(again.plan)) == []


@pytest.mark.usefixtures("everything_is_large")
def test_the_command_plans_a_large_fleet_and_prints_nothing_but_json(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Any
) -> None:
    file = tmp_path / "scenario.json"
    file.write_text(laid_out("uniform", 20, 60, 4, seed=1).model_dump_json())
    monkeypatch.setattr(sys, "argv", ["skyfolio", "plan", str(file), "--json"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code in {0, None}
    made = Plan.model_validate_json(capsys.readouterr().out)
    assert made.method == "areas"
    monkeypatch.setattr(sys, "argv", ["skyfolio", "bound", str(file), "--seconds", "1", "--json"])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code in {0, None}
    figures = json.loads(capsys.readouterr().out)
    assert figures["utility_bps"] <= figures["upper_bound_bps"] <= figures["root_bound_bps"]
