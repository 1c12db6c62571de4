"""What is kept of drills: a line of JSON for each, what all of them come to, and the coverage of states and moments."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

from skyfolio.api.lab.torture.drill import Drill


@dataclass(frozen=True, kw_only=True)
class Result:
    """What is kept of one drill. small: the shrunk drill, if it broke something."""

    seed: int
    state: str
    broken: dict[str, str]
    coverage: Counter[tuple[str, str]]
    virtual_s: float
    wall_s: float
    moments: Counter[tuple[str, str]] = field(default_factory=Counter)
    small: Drill | None = None

    def line(self) -> str:
        """Return it as a line of JSON, without the shrunk drill."""
        document = {
            "seed": self.seed,
            "state": self.state,
            "broken": self.broken,
            "coverage": [[*of, count] for of, count in self.coverage.items()],
            "moments": [[*of, count] for of, count in self.moments.items()],
            "virtual_s": round(self.virtual_s, 2),
            "wall_s": round(self.wall_s, 4),
        }
        return json.dumps(document) + "\n"

    @classmethod
    def of_line(cls, line: str) -> Result:
        """Return what is in a line of JSON. Raises ValueError, KeyError or TypeError."""
        document = json.loads(line)
        for name in ("coverage", "moments"):
            document[name] = Counter({(at, blow): count for at, blow, count in document[name]})
        return cls(**document)


@dataclass
class Tally:
    """What came of a campaign so far."""

    drills: int = 0
    states: Counter[str] = field(default_factory=Counter)
    broken: Counter[str] = field(default_factory=Counter)
    coverage: Counter[tuple[str, str]] = field(default_factory=Counter)
    moments: Counter[tuple[str, str]] = field(default_factory=Counter)
    walls_s: list[float] = field(default_factory=list)
    virtual_s: float = 0.0
    failures: list[Result] = field(default_factory=list)

    def add(self, result: Result) -> None:
        """Take in one drill."""
        self.drills += 1
        self.states[result.state] += 1
        self.coverage.update(result.coverage)
        self.moments.update(result.moments)
        self.broken.update(result.broken.keys())
        self.walls_s.append(result.wall_s)
        self.virtual_s += result.virtual_s
        if result.broken:
            self.failures.append(result)

    def report(self) -> dict[str, Any]:
        """Return all of it as plain data."""
        return {
            "drills": self.drills,
            "failed": len(self.failures),
            "states": dict(sorted(self.states.items())),
            "broken": dict(self.broken.most_common()),
            "wall_p50_s": round(median(self.walls_s), 3) if self.walls_s else None,
            "flown_s": round(self.virtual_s, 1),
            "coverage": {f"{state}/{blow}": count for (state, blow), count in sorted(self.coverage.items())},
            "moments": {f"{moment}/{blow}": count for (moment, blow), count in sorted(self.moments.items())},
            "failures": [{"seed": one.seed, "state": one.state, "broken": one.broken} for one in self.failures],
        }


class ResultFile:
    """The results of drills, a line each as they are flown, so that a campaign may be stopped and go on."""

    def __init__(self, file: Path) -> None:
        self._file = file

    def begin(self) -> None:
        """Forget what was flown before."""
        self._file.parent.mkdir(parents=True, exist_ok=True)
        self._file.write_text("", encoding="utf-8")

    def add(self, result: Result) -> None:
        """Keep one more."""
        self._file.parent.mkdir(parents=True, exist_ok=True)  # a campaign may go on where none was begun
        with self._file.open("a", encoding="utf-8") as opened:
            opened.write(result.line())

    def newest(self) -> dict[int, Result]:
        """Return the newest result of each seed.

        A last line that is unfinished is left out: its campaign was killed. Raises ValueError for any other that is no
        result.
        """
        if not self._file.exists():
            return {}
        text = self._file.read_text(encoding="utf-8")
        whole = text[: text.rfind("\n") + 1]
        if whole != text:
            self._file.write_text(whole, encoding="utf-8")
        return {result.seed: result for result in self._read(whole)}

    def _read(self, text: str) -> Iterator[Result]:
        for number, line in enumerate(text.splitlines(), start=1):
            try:
                yield Result.of_line(line)
            except (ValueError, KeyError, TypeError) as error:
                raise ValueError(f"{self._file}, line {number}: is no result of a drill: {error}") from error


def table_of(coverage: Counter[tuple[str, str]]) -> list[list[str]]:
    """Return how often each blow struck in each state, as rows of text with a heading."""
    states = sorted({state for state, _ in coverage})
    blows = sorted({blow for _, blow in coverage})
    rows = [["", *states]]
    return rows + [[blow, *(str(coverage[state, blow] or "·") for state in states)] for blow in blows]


def moments_of(moments: Counter[tuple[str, str]]) -> list[list[str]]:
    """Return what struck at each kind of moment, as rows of text: moment, blows with their counts."""
    rows = []
    for moment in sorted({moment for moment, _ in moments}):
        struck = sorted((blow, count) for (at, blow), count in moments.items() if at == moment)
        rows.append([moment, ", ".join(f"{blow} {count}" for blow, count in struck)])
    return rows
