"""Where the planner's compiled kernels are kept, and when they are compiled.

Compiling takes most of a minute, loading what was compiled half a second. numba keeps what it compiled beside the
sources or in the user's home, and fails where it can write neither (a container, another user, no home). So a folder is
chosen before numba is imported, the first of these that can be written:

    NUMBA_CACHE_DIR, when it is set
    planner/__pycache__/kernels-DIGEST               beside the sources, as they were installed
    $XDG_CACHE_HOME/skyfolio/kernels-DIGEST          else ~/.cache
    $TMPDIR/skyfolio-UID/kernels-DIGEST              a folder of this user alone, else one that ends with the process

DIGEST is of all kernels' sources: numba itself does not notice when a kernel that another one calls was edited. What
was compiled at install beside read-only sources is copied, so that nothing is compiled twice. Nothing here imports
numba before it is needed. numba replaces files whole, so processes may compile and load at the same time.
"""

from __future__ import annotations

import atexit
import fcntl
import os
import shutil
import stat
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from hashlib import sha256
from importlib.util import find_spec
from pathlib import Path
from typing import Any

VARIABLE = "NUMBA_CACHE_DIR"
REPORTED = "_SKYFOLIO_KERNELS_REPORTED"
"""Set for this process and its children once it was written to standard error where kernels are kept."""
SAY_EVERY_S = 5.0
_OURS = "skyfolio-"
"""Prefix of our temporary folders; code that was installed in a temporary folder has its kernels beside it."""
_PLANNER = Path(str(getattr(find_spec("skyfolio.planner"), "origin", None))).parent
_STEMS = (
    "fast/*.py",
    "crowding/*.py",
    "areas/noise.py",
    "areas/matching.py",
    "utilities/kind.py",
    "cells.py",
    "repair.py",
)


def choose_folder() -> None:
    """Choose the folder for this process and its children. Cheap; called before anything can import numba."""
    configured = os.environ.get(VARIABLE)
    if configured and _writable(Path(configured)):
        return
    name = f"kernels-{_digest()}"
    installed = _PLANNER / "__pycache__" / name
    chosen = next((candidate for candidate in (installed, *_homes(name)) if _writable(candidate)), None)
    if chosen is None:
        chosen = _temporary(name)
    if chosen != installed:
        _copy_missing(installed, chosen)
    os.environ[VARIABLE] = str(chosen)
    if "numba" in sys.modules:  # imported by somebody before us, with the variable as it was then
        sys.modules["numba"].config.CACHE_DIR = str(chosen)


def folder() -> Path:
    """Return the folder that `choose_folder` has chosen."""
    return Path(os.environ[VARIABLE])


def report_temporary_folder(say: Callable[[str], None]) -> None:
    """Report once, for this process and its children, that kernels are only kept in a temporary folder."""
    temporary = Path(tempfile.gettempdir())
    in_ours = folder().is_relative_to(temporary) and folder().relative_to(temporary).parts[0].startswith(_OURS)
    if os.environ.get(REPORTED) or not in_ours:
        return
    os.environ[REPORTED] = "1"
    say(
        f"compiled kernels are kept in {folder()}: neither the code's folder nor a home can be written (set {VARIABLE})"
    )


@contextmanager
def compiling(note: Callable[[int], None]) -> Iterator[None]:
    """Call `note` at each step of compiling with how many kernels are being compiled: 0 when that is over."""
    from numba.core import event  # noqa: PLC0415 - half a second that most commands do not need

    class Listener(event.Listener):  # type: ignore[misc]
        depth = 0

        def on_start(self, event: Any) -> None:
            self.depth += event.kind == COMPILE
            note(self.depth)

        def on_end(self, event: Any) -> None:
            self.depth -= event.kind == COMPILE
            note(self.depth)

    listener = Listener()
    with event.install_listener(COMPILE, listener), event.install_listener("numba:run_pass", listener):
        yield


COMPILE = "numba:compile"


def load_all(say: Callable[[str], None] | None = None) -> int:
    """Load every kernel, and compile those that are missing, reporting progress. Return how many were compiled.

    One process compiles at a time: two could store different signatures of a kernel under one name.
    """
    from skyfolio.api.common.plugins import load_plugins  # noqa: PLC0415 - looks through what is installed
    from skyfolio.planner.rehearsal import rehearse  # noqa: PLC0415 - loads numba

    load_plugins()  # where kernels are wanted, something is planned

    progress = _Progress(say or (lambda _: None))
    with compiling(progress.note), _alone():
        rehearse()
    if progress.compiled:
        progress.say(f"{progress.compiled} kernels compiled into {folder()}")
    return progress.compiled


@contextmanager
def _alone() -> Iterator[None]:
    """Lock out other processes that compile, unless everything has been compiled for this machine before."""
    import llvmlite.binding  # noqa: PLC0415
    import numba  # noqa: PLC0415

    machine = f"{llvmlite.binding.get_host_cpu_name()} {llvmlite.binding.get_host_cpu_features().flatten()}"
    complete = folder() / f"complete-{numba.__version__}-{sha256(machine.encode()).hexdigest()[:8]}"
    if complete.exists():
        yield
        return
    with (folder() / "lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        yield
        complete.touch()


class _Progress:
    """Counts kernels as numba compiles them, and reports now and then."""

    def __init__(self, say: Callable[[str], None]) -> None:
        self.say = say
        self.compiled = 0
        self._depth = 0
        self._said_s = time.monotonic()

    def note(self, depth: int) -> None:
        """Note how many kernels are being compiled now."""
        begun, self._depth = depth > self._depth, depth
        if not begun:
            return
        self.compiled += 1
        now_s = time.monotonic()
        if self.compiled == 1:
            self.say("compiling the optimiser, once on this machine: about a minute")
        elif now_s - self._said_s >= SAY_EVERY_S:
            self.say(f"compiling the optimiser: {self.compiled} kernels so far")
        else:
            return
        self._said_s = now_s


def _digest() -> str:
    digest = sha256()
    for pattern in _STEMS:
        for source in sorted(_PLANNER.glob(pattern)):
            digest.update(source.name.encode() + b"\0" + source.read_bytes())
    return digest.hexdigest()[:16]


def _homes(name: str) -> Iterator[Path]:
    """Yield the folder below the user's cache folder, if there is a home at all."""
    cache = os.environ.get("XDG_CACHE_HOME")
    if cache:
        yield Path(cache) / "skyfolio" / name
        return
    try:
        yield Path.home() / ".cache" / "skyfolio" / name
    except RuntimeError:  # no HOME, and nobody of this user id: a container
        return


def _writable(folder: Path) -> bool:
    """Return whether a file can be created in the folder, which is created if needed."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=folder):
            return True
    except OSError:
        return False


def _temporary(name: str) -> Path:
    """Return a temporary folder that no other user can write, since its content is executed.

    It is kept when it belongs to this user, else removed when the process ends.
    """
    shared = Path(tempfile.gettempdir()) / f"{_OURS}{os.getuid()}"
    try:
        shared.mkdir(mode=0o700, exist_ok=True)
        status = shared.lstat()
    except OSError:
        status = None
    if status and stat.S_ISDIR(status.st_mode) and status.st_uid == os.getuid() and not status.st_mode & 0o077:
        kept = shared / name
        if _writable(kept):
            return kept
    private = Path(tempfile.mkdtemp(prefix=f"{_OURS}kernels-"))
    atexit.register(_remove, private, os.getpid())
    return private


def _remove(folder: Path, owner: int) -> None:
    if os.getpid() == owner:  # not a child that inherited the folder
        shutil.rmtree(folder, ignore_errors=True)


def _copy_missing(source: Path, target: Path) -> None:
    """Copy what was compiled at install; files appear whole, for processes that load at the same time."""
    if not source.is_dir():
        return
    for file in source.rglob("*.nb[ci]"):
        copy = target / file.relative_to(source)
        if copy.exists():
            continue
        copy.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.NamedTemporaryFile(dir=copy.parent, delete=False) as temporary:
            temporary.write(file.read_bytes())
        Path(temporary.name).replace(copy)
