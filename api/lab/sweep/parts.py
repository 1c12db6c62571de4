"""The results of a sweep: Parquet files of one batch each, named by what was asked, so that none is computed twice.

    FOLDER/parts/part-ADDRESS.parquet    the rows of one batch, written whole or not at all
    FOLDER/sweep.json                    what was asked: the spec, and the addresses of all its parts
    FOLDER/lock                          held by the process that computes

ADDRESS is a digest of the base, the settings of the batch's cases and the planner: the same request finds it again.
"""

from __future__ import annotations

import fcntl
import io
import json
import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cache
from hashlib import sha256
from pathlib import Path
from tempfile import NamedTemporaryFile
from typing import Any

from skyfolio.api.common import kernels
from skyfolio.api.common.errors import ServiceError
from skyfolio.api.common.planner_identity import planner_identity, require_planner
from skyfolio.api.lab.sweep.case import MEASURES, row_of
from skyfolio.api.lab.sweep.spec import Base, Settings, Spec

FORMAT = 1
MANIFEST = "sweep.json"
NEW = ".new"
"""Suffix of what is being written; such a file that is left over is worth nothing."""
READABLE = 0o666
"""Permissions of results, as of any file that is written; temporary files are their owner's alone."""
TEXT = (list, dict)
"""Settings of these types are stored as JSON text, so that they can be grouped by."""


class SweepError(ServiceError):
    """A sweep cannot be computed or read here."""


@cache
def rows_identity() -> str:
    """Return what tells rows apart that are made of the same settings: the planner, and the code that measures."""
    digest = sha256(str(FORMAT).encode())
    for name in ("case.py", "settings.py"):
        digest.update(Path(__file__).with_name(name).read_bytes())
    return f"{planner_identity()}-{digest.hexdigest()[:8]}"


@cache
def _load_kernels() -> None:
    """Load all kernels, once in each worker."""
    kernels.load_all()


@dataclass(frozen=True, kw_only=True)
class Batch:
    """Cases that one worker computes in a row. first: the number of the first. base: as JSON. planner: its identity."""

    address: str
    planner: str
    first: int
    base: str
    fixed: Settings
    cases: tuple[Settings, ...]


def batches_of(spec: Spec) -> list[Batch]:
    """Return all batches of a sweep, in order."""
    base, planner, cases = spec.base.model_dump_json(), planner_identity(), spec.cases()
    made = []
    for first in range(0, len(cases), spec.batch):
        chunk = tuple(cases[first : first + spec.batch])
        asked = json.dumps([rows_identity(), base, spec.fixed, first, chunk], sort_keys=True)
        address = sha256(asked.encode()).hexdigest()[:24]
        made.append(Batch(address=address, planner=planner, first=first, base=base, fixed=spec.fixed, cases=chunk))
    return made


def compute(batch: Batch) -> bytes:
    """Return the part of a batch, Parquet; runs in a worker. Raises OtherPlannerError."""
    require_planner(batch.planner)
    _load_kernels()
    base = Base.model_validate_json(batch.base)
    return part_of(batch, [row_of(base, {**batch.fixed, **varied}) for varied in batch.cases])


def part_of(batch: Batch, results: Sequence[dict[str, Any]]) -> bytes:
    """Return the part of a batch, Parquet: each case's number and settings, and its results as `row_of` gives them."""
    import pyarrow as pa  # noqa: PLC0415 - an extra
    import pyarrow.parquet as pq  # noqa: PLC0415

    scalars = {str: pa.string(), int: pa.int64(), float: pa.float64(), bool: pa.bool_()}
    columns = [
        ("case", pa.int64()),
        *((name, scalars.get(type(value), pa.string())) for name, value in {**batch.fixed, **batch.cases[0]}.items()),
        ("status", pa.string()),
        ("error", pa.string()),
        *((name, pa.float64()) for name in MEASURES),
        ("user_rates_bps", pa.list_(pa.float64())),
    ]
    rows = []
    for number, (varied, result) in enumerate(zip(batch.cases, results, strict=True), start=batch.first):
        settings = {**batch.fixed, **varied}
        shown = {name: json.dumps(value) if isinstance(value, TEXT) else value for name, value in settings.items()}
        rows.append({"case": number, **shown, **result})
    sink = io.BytesIO()
    pq.write_table(pa.Table.from_pylist(rows, schema=pa.schema(columns)), sink, compression="zstd")
    return sink.getvalue()


class Parts:
    """The folder of one sweep's results."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._parts = folder / "parts"

    @contextmanager
    def held(self) -> Iterator[None]:
        """Create the folder and hold it, without what a killed process left over. Raises SweepError when it is held."""
        try:
            self._parts.mkdir(parents=True, exist_ok=True)
            lock = (self.folder / "lock").open("w")
        except OSError as error:
            raise SweepError(f"--out: {self.folder}: {error.strerror or error}") from error
        with lock:
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise SweepError(f"--out: another process computes a sweep into {self.folder}") from error
            for left in (*self._parts.glob(f"*{NEW}"), *self.folder.glob(f"*{NEW}")):
                left.unlink()
            yield

    def there(self) -> set[str]:
        """Return the addresses of all parts that are there, of this sweep and of others."""
        return {file.stem.removeprefix("part-") for file in self._parts.glob("part-*.parquet")}

    def path(self, address: str) -> Path:
        """Return the file of a part."""
        return self._parts / f"part-{address}.parquet"

    def write(self, address: str, part: bytes) -> None:
        """Write a part, whole or not at all."""
        _write_whole(self.path(address), part)

    def describe(self, spec: Spec, batches: Sequence[Batch]) -> None:
        """Write down what this sweep is, so that its parts are known among those of others."""
        told = {
            "format": FORMAT,
            "planner": batches[0].planner,
            "cases": spec.n_cases,
            "varied": list(spec.vary),
            "averaged": list(spec.averaged),
            "parts": [batch.address for batch in batches],
            "spec": spec.model_dump(mode="json"),
        }
        _write_whole(self.folder / MANIFEST, (json.dumps(told, indent=1) + "\n").encode())

    def description(self) -> dict[str, Any]:
        """Return what `describe` has written. Raises SweepError when there is none."""
        file = self.folder / MANIFEST
        try:
            told: dict[str, Any] = json.loads(file.read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError, json.JSONDecodeError) as error:
            raise SweepError(f"{file}: no sweep is there ({error})") from error
        return told


@cache
def _umask() -> int:
    """Return which permissions this user takes from new files; they can only be read by setting them."""
    mask = os.umask(0o077)
    os.umask(mask)
    return mask


def _write_whole(file: Path, content: bytes) -> None:
    """Replace a file: after a crash at any moment, even of the machine, it is the old one or the new one."""
    with NamedTemporaryFile(dir=file.parent, prefix=file.name, suffix=NEW, delete=False) as new:
        new.write(content)
        new.flush()
        os.fchmod(new.fileno(), READABLE & ~_umask())
        os.fsync(new.fileno())
    Path(new.name).replace(file)
