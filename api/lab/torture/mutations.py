"""Planted bugs: each a small change of the source, applied to a copy of the package, and hunted by drills.

A mutation says nothing about a service that is right; it says whether drills would find one that is wrong. One that
survives its drills names an invariant that is missing, or a moment that the generator does not aim at.

Mutations are tables of TOML files, `[[mutation]]`: `name`, `file` (in the package), `why` (what somebody got wrong),
`before` and `after`, the text that is replaced, which must be there exactly once, `aims`, of drills that should find
it, and `found_by`, the seed of a drill that has. Those are flown first, because drills take time; but only those that a
campaign of these seeds would fly too.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from importlib import import_module
from pathlib import Path

import skyfolio
from skyfolio.api.lab.torture.aims import AIMS, aim_of

CHANGED_PARTS = ("api", "mavlink_bridge")
"""The parts of the package that mutations change."""
HUNTER = "skyfolio.api.lab.torture.hunter"


@dataclass(frozen=True, kw_only=True)
class Mutation:
    """One planted bug.

    file: its path in the package. why: what somebody got wrong. aims: names of `aims.AIMS`. found_by: the seed of a
    drill that has found it, None if none has.
    """

    name: str
    file: str
    why: str
    before: str
    after: str
    aims: Sequence[str] = ()
    found_by: int | None = None

    def __post_init__(self) -> None:
        """Refuse aims that no drill has."""
        unknown = [aim for aim in self.aims if aim not in AIMS]
        if unknown:
            raise ValueError(f"aims: {', '.join(unknown)} of mutation {self.name!r} is not one of {', '.join(AIMS)}")

    @property
    def digest(self) -> str:
        """Return what tells it from any other, and from itself before it was changed."""
        change = [self.name, self.file, self.before, self.after]
        return hashlib.sha256(json.dumps(change).encode()).hexdigest()[:16]

    def rank(self, seed: int) -> int:
        """Return how soon the drill of a seed should be flown for it: the lowest first."""
        return 0 if seed == self.found_by else 1 if aim_of(seed) in self.aims else 2

    def applied(self, source: str) -> str:
        """Return the source with the bug in it. Raises ValueError if it does not fit, or does not compile."""
        places = source.count(self.before)
        if places != 1:
            raise ValueError(f"before: the text of mutation {self.name!r} is {places} times in {self.file}, not once")
        changed = source.replace(self.before, self.after)
        try:
            compile(changed, self.file, "exec")
        except SyntaxError as error:
            raise ValueError(f"after: mutation {self.name!r} does not compile: {error}") from error
        return changed


@dataclass(frozen=True, kw_only=True)
class Hunt:
    """How the hunt for one mutation went. flown: the seeds of its drills, in order. seed: of the one that found it.

    broken: what that drill broke, by invariant; the same drill breaks nothing without the mutation.
    """

    name: str
    digest: str
    flown: Sequence[int]
    seed: int | None = None
    broken: Mapping[str, str] | None = None

    @property
    def found(self) -> bool:
        """Return whether a drill has found it."""
        return self.seed is not None


def read_mutations(folder: Path) -> list[Mutation]:
    """Return the mutations in the files of a folder. Raises ValueError or OSError."""
    found = []
    for file in sorted(folder.glob("*.toml")):
        for table in tomllib.loads(file.read_text(encoding="utf-8"))["mutation"]:
            try:
                found.append(Mutation(**table))
            except TypeError as error:
                raise ValueError(f"{file}: {error}") from error
    names = [mutation.name for mutation in found]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise ValueError(f"name: {', '.join(twice)} is given twice in {folder}")
    return found


def source_of(mutation: Mutation) -> str:
    """Return the source that a mutation changes, as it is in this package."""
    part, _, rest = mutation.file.partition("/")
    if part not in CHANGED_PARTS:
        raise ValueError(f"file: {mutation.file} of {mutation.name!r} is not in {' or '.join(CHANGED_PARTS)}")
    return (_folder_of(part) / rest).read_text(encoding="utf-8")


@contextmanager
def copy_with(mutation: Mutation) -> Iterator[Path]:
    """Make a copy of what mutations change, with the bug in it; return the folder to import `skyfolio` from.

    Everything else is imported from where it is, so that the kernels of the planner are not compiled again.
    """
    changed = mutation.applied(source_of(mutation))
    with tempfile.TemporaryDirectory(prefix="skyfolio-mutation-") as folder:
        package = Path(folder) / "skyfolio"
        package.mkdir()
        here = Path(str(skyfolio.__file__))
        rest = f"__path__ += {list(skyfolio.__path__)!r}\n"
        (package / here.name).write_text(rest + here.read_text(encoding="utf-8"), encoding="utf-8")
        for part in CHANGED_PARTS:
            shutil.copytree(_folder_of(part), package / part, ignore=shutil.ignore_patterns("skyfolio"))
        (package / mutation.file).write_text(changed, encoding="utf-8")
        yield Path(folder)


class Baseline:
    """Which drills break something without any mutation; each is flown once. known: by seed, whether it does."""

    def __init__(self, known: Mapping[int, bool] | None = None) -> None:
        self.known = dict(known or {})

    def breaks(self, seed: int) -> bool:
        """Return whether the drill of this seed breaks something in this package as it is."""
        if seed not in self.known:
            self.known[seed] = _first_failure(None, [seed]) is not None
        return self.known[seed]


def hunt(
    mutation: Mutation,
    baseline: Baseline,
    seeds: Sequence[int],
    *,
    tries: int | None = None,
    flown: Collection[int] = (),
) -> Hunt:
    """Fly drills of these seeds with a mutated copy, until one breaks what it does not break without the mutation.

    tries: the most that are flown, the likely ones first; None flies all. flown: seeds that were flown for it before.
    """
    before = list(flown)
    left = [seed for seed in sorted(seeds, key=mutation.rank)[:tries] if seed not in set(before)]
    found: tuple[int, dict[str, str]] | None = None
    with copy_with(mutation) as folder:
        while left and found is None:
            failure = _first_failure(folder, left)
            count = len(left) if failure is None else left.index(failure[0]) + 1
            before, left = before + left[:count], left[count:]
            found = None if failure is None or baseline.breaks(failure[0]) else failure
    return Hunt(
        name=mutation.name,
        digest=mutation.digest,
        flown=before,
        seed=None if found is None else found[0],
        broken=None if found is None else found[1],
    )


def hunt_all(
    mutations: Iterable[Mutation],
    results: Path,
    *,
    seeds: Sequence[int],
    tries: int | None = None,
    jobs: int = 1,
    told: Callable[[Hunt], None],
) -> list[Hunt]:
    """Hunt each mutation, `jobs` at a time, and keep the results in a file; what that file has is not done again.

    One that was not found before is hunted on with the drills that were not flown for it yet. The file belongs to one
    state of the sources: delete it when they have changed.
    """
    known, baseline = _read_results(results)
    planted = list(mutations)

    def hunt_one(mutation: Mutation) -> Hunt:
        done = known.get(mutation.digest)
        if done is None or not done.found:
            flown = () if done is None else done.flown
            done = hunt(mutation, baseline, seeds, tries=tries, flown=flown)
        return done

    with ThreadPoolExecutor(jobs) as pool:
        for done in as_completed([pool.submit(hunt_one, mutation) for mutation in planted]):
            one = done.result()
            known[one.digest] = one
            _write_results(results, known.values(), baseline)
            told(one)
    return [known[mutation.digest] for mutation in planted]


def _folder_of(part: str) -> Path:
    return Path(next(iter(import_module(f"skyfolio.{part}").__path__)))


def _first_failure(folder: Path | None, seeds: Sequence[int]) -> tuple[int, dict[str, str]] | None:
    """Return the first of these seeds whose drill breaks something, and what; None if none does.

    folder: where the package is imported from; None for this one.
    """
    environment = dict(os.environ)
    paths = [*map(str, [folder] if folder is not None else []), *sys.path]
    environment["PYTHONPATH"] = os.pathsep.join(path for path in paths if path)
    done = subprocess.run(  # noqa: S603 - our own module
        [sys.executable, "-m", HUNTER],
        input=json.dumps(list(seeds)),
        env=environment,
        cwd=tempfile.gettempdir(),
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode != 0:
        raise RuntimeError(f"the drills did not run: {done.stderr[-2000:]}")
    found = json.loads(done.stdout.splitlines()[-1])
    return None if found is None else (found["seed"], found["broken"])


def _read_results(file: Path) -> tuple[dict[str, Hunt], Baseline]:
    if not file.is_file():
        return {}, Baseline()
    document = json.loads(file.read_text(encoding="utf-8"))
    known = {int(seed): breaks for seed, breaks in document["baseline"].items()}
    return {row["digest"]: Hunt(**row) for row in document["mutations"]}, Baseline(known)


def _write_results(file: Path, hunts: Iterable[Hunt], baseline: Baseline) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    document = {"baseline": dict(baseline.known), "mutations": [asdict(one) for one in hunts]}
    new = file.with_suffix(".new")
    new.write_text(json.dumps(document, indent=1) + "\n", encoding="utf-8")
    new.replace(file)
