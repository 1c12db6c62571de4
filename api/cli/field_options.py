"""Options of `simulate` and `serve` for what happens around a simulated fleet: its ground crew, packs and the wind."""

from typing import Annotated

import typer

Crew = Annotated[
    int | None,
    typer.Option(
        min=0,
        max=100,
        help="How many people change batteries of vehicles that have landed on their pads: --crew 2. 0: no crew.",
    ),
]
Turnaround = Annotated[
    float | None,
    typer.Option(
        "--turnaround",
        min=10,
        max=1e6,
        help="Seconds one of them takes, the last 20 with the vehicle switched off: --turnaround 90.",
    ),
]
PacksOfPad = Annotated[
    str | None,
    typer.Option(
        "--packs",
        help="Batteries of each pad: count=4,charge_s=3600,worn_cycles=150,fade_per_cycle=0.0008,"
        "resistance_per_cycle=0.003,spread=0.1.",
    ),
]
BatteryMinutes = Annotated[
    float | None,
    typer.Option(
        min=1, max=300, help="Hovering time on a new, full battery until 20 % is left, minutes: --battery-minutes 18."
    ),
]
Fronts = Annotated[
    list[str] | None,
    typer.Option(
        "--front",
        help="The wind changes: at_s=600,east_mps=6,north_mps=-2,gust_mps=1.5,ramp_s=120; may be given several times.",
    ),
]
