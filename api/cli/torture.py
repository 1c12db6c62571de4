"""`skyfolio torture`: drills by the thousand in virtual time."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from skyfolio.api.cli.files import Json, UsageError

if TYPE_CHECKING:
    from skyfolio.api.lab.torture.tally import Tally


def torture(
    drills: Annotated[int, typer.Option(min=0, help="How many.")] = 100,
    seed: Annotated[int, typer.Option(min=0, help="Of the first drill; the next ones count on.")] = 1,
    jobs: Annotated[int, typer.Option(min=1, help="How many at a time, each on a core of its own.")] = 1,
    out: Annotated[Path, typer.Option(help="Write failing drills here, each a file to replay.")] = Path("out/torture"),
    resume: Annotated[
        bool,
        typer.Option(
            help="Count what OUT/drills.jsonl has, and fly only what it has not, or what broke something; with "
            "--drills 0 nothing is flown."
        ),
    ] = False,
    shrink: Annotated[bool, typer.Option(help="Make failing drills smaller first.")] = True,
    replay: Annotated[Path | None, typer.Option(help="Fly the drill in this file instead, and show each step.")] = None,
    mutations: Annotated[
        Path | None,
        typer.Option(help="Plant each bug of this folder in a copy of the package instead, and see which are found."),
    ] = None,
    tries: Annotated[
        int | None,
        typer.Option(
            min=1, help="With --mutations: fly only so many of the drills for each bug, the likely ones first."
        ),
    ] = None,
    recording: Annotated[
        Path | None, typer.Option(help="With --replay: write a database here whose flight the dashboard replays.")
    ] = None,
    as_json: Json = False,
) -> None:
    """Fly random drills in virtual time, and look at what must hold whatever happens.

    Each drill is a service with a fleet, struck at the moments that hurt. Exit status 1 if anything was broken, or with
    --mutations if a planted bug was not found in that many drills. What came of each drill is kept in OUT/drills.jsonl,
    which begins anew without --resume; results of planted bugs are kept in OUT/mutations.json, and a hunt that was
    stopped goes on from there.
    """
    if recording is not None and replay is None:
        raise UsageError("--recording: only a drill that is replayed is recorded; name its file with --replay")
    if mutations is not None:
        broken = _hunt(
            mutations, range(seed, seed + drills), out / "mutations.json", tries=tries, jobs=jobs, as_json=as_json
        )
    elif replay is not None:
        broken = _replay(replay, recording, as_json=as_json)
    else:
        if not drills and not resume:
            raise UsageError("--drills: 0 flies nothing; it adds up what was flown before, with --resume")
        broken = _campaign(range(seed, seed + drills), jobs, out, resume=resume, shrink=shrink, as_json=as_json)
    if broken:
        raise typer.Exit(1)


def _campaign(seeds: range, jobs: int, out: Path, *, resume: bool, shrink: bool, as_json: bool) -> bool:
    from skyfolio.api.lab.torture.campaign import campaign, write_case  # noqa: PLC0415
    from skyfolio.api.lab.torture.tally import Result, ResultFile, Tally  # noqa: PLC0415

    results = ResultFile(out / "drills.jsonl")
    if not resume:
        results.begin()
    try:
        known = results.newest()
    except ValueError as error:
        raise UsageError(f"--resume: {error}") from error
    to_fly = [seed for seed in seeds if seed not in known or known[seed].broken]
    done = 0

    def told(result: Result) -> None:
        nonlocal done
        done += 1
        for name, detail in result.broken.items():
            typer.echo(f"drill {result.seed}: {name}: {detail}", err=True)
        if result.broken:
            typer.echo(f"drill {result.seed}: skyfolio torture --replay {write_case(out, result)}", err=True)
        if done % 50 == 0:
            typer.echo(f"{done} of {len(to_fly)} drills", err=True)
        known[result.seed] = result

    campaign(to_fly, jobs=jobs, shrink=shrink, results=results, told=told)
    tally = Tally()
    for seed in sorted(known):
        tally.add(known[seed])
    _show(tally, as_json=as_json)
    return bool(tally.failures)


def _show(tally: Tally, *, as_json: bool) -> None:
    from skyfolio.api.lab.torture.tally import moments_of, table_of  # noqa: PLC0415

    report = tally.report()
    if as_json:
        typer.echo(json.dumps(report))
        return
    for row in table_of(tally.coverage):
        typer.echo(f"{row[0]:16}" + "".join(f"{cell:>17}" for cell in row[1:]))
    for moment, struck in moments_of(tally.moments):
        typer.echo(f"{moment:26}{struck}")
    typer.echo(
        f"\n{report['drills']} drills, {report['failed']} failed; {report['flown_s']:.0f} s flown, "
        f"{report['wall_p50_s'] or 0.0:.2f} s each (median)"
    )
    for name, count in report["broken"].items():
        typer.echo(f"{count:6}  {name}")


def _hunt(folder: Path, seeds: range, results: Path, *, tries: int | None, jobs: int, as_json: bool) -> bool:
    from skyfolio.api.lab.torture.mutations import Hunt, hunt_all, read_mutations  # noqa: PLC0415

    try:
        planted = read_mutations(folder)
    except (OSError, ValueError) as error:
        raise UsageError(f"{folder}: {error}") from error

    def told(hunt: Hunt) -> None:
        what = ", ".join(hunt.broken or ()) or "not found"
        by = f"by drill {hunt.seed} after" if hunt.found else "by"
        typer.echo(f"{hunt.name}: {what} ({by} {len(hunt.flown)} drills)", err=True)

    hunts = hunt_all(planted, results, seeds=seeds, tries=tries, jobs=jobs, told=told)
    missed = [hunt.name for hunt in hunts if not hunt.found]
    if as_json:
        typer.echo(json.dumps({"mutations": [asdict(hunt) for hunt in hunts], "missed": missed}))
    else:
        typer.echo(f"{len(hunts) - len(missed)} of {len(hunts)} found; not found: {', '.join(missed) or 'none'}")
    return bool(missed)


def _replay(file: Path, recording: Path | None, *, as_json: bool) -> bool:
    from skyfolio.api.lab.torture.campaign import flown, quiet, read_case  # noqa: PLC0415

    try:
        drill = read_case(file)
    except (OSError, ValueError, KeyError) as error:
        raise UsageError(f"{file}: is no drill: {error}") from error
    if recording is not None and recording.exists():
        raise UsageError(f"{recording}: is there already; name a new file")
    with quiet():
        outcome = flown(drill, recording)
    if as_json:
        document = {"broken": outcome.broken, "state": outcome.state, "blows": outcome.blows, "steps": outcome.steps}
        events = [event.model_dump(mode="json") for event in outcome.events]
        typer.echo(json.dumps({**document, "events": events}))
        return bool(outcome.broken)
    for step in outcome.steps:
        typer.echo(step)
    typer.echo(f"{outcome.state} after {outcome.virtual_s:.0f} s, flown in {outcome.wall_s:.2f} s")
    for name, detail in outcome.broken.items():
        typer.echo(f"broken: {name}: {detail}")
    if recording is not None:
        url = f"sqlite+aiosqlite:///{recording.resolve()}"
        typer.echo(f"To watch it, on the page Replay: SKYFOLIO_DATABASE_URL={url} skyfolio serve")
    return bool(outcome.broken)
