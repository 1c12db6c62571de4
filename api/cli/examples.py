"""An example of every command, shown at the end of its `--help`; a test parses each, so that none can go stale."""

from __future__ import annotations

from collections.abc import Mapping

EXAMPLES: Mapping[str, str] = {
    "bench allocations": "skyfolio bench allocations --seeds 2 --json",
    "bench areas": "skyfolio bench areas --uavs 100 --compare",
    "bench bridge": "skyfolio bench bridge --swaps 20 --load-s 10",
    "bench drills": "skyfolio bench drills --runs 3",
    "bench channels": "skyfolio bench channels links.csv --carrier-hz 3.5e9",
    "bench energy": "skyfolio bench energy --flights 4",
    "bench planner": "skyfolio bench planner --quick --section fast --utility sum",
    "bench radio": "skyfolio bench radio --layouts 4",
    "bench report": "skyfolio bench report figures.json --out planner.md",
    "bench scale": "skyfolio bench scale --quick",
    "bench service": "skyfolio bench service --only plans",
    "bench simulator": "skyfolio bench simulator --vehicles 50 --seconds 10",
    "bench start": "skyfolio bench start --runs 3",
    "bound": "skyfolio bound --example paper --tolerance 0.01 --seconds 30",
    "check": "skyfolio check udpin://0.0.0.0:14550 --system-id 1 --wait-s 30",
    "completion": "skyfolio completion bash > ~/.local/share/bash-completion/completions/skyfolio",
    "demo": "skyfolio demo --kill uav-2 --kill-slot 11 --out out/demo",
    "drill": "skyfolio drill op-1a2b3c uav-3 --fault kill --at-slot 12",
    "explain": "skyfolio explain plan.json --resolves 8 --deadline-s 20",
    "export": "skyfolio export plan.json --format waypoints --uav-id uav-1 --out uav-1.waypoints",
    "fleet hold": "skyfolio fleet hold uav-1 uav-2",
    "fleet land": "skyfolio fleet land uav-3 --force",
    "fleet list": "skyfolio fleet list --json",
    "fleet register": "skyfolio fleet register uav-1 1",
    "fleet return": "skyfolio fleet return",
    "fly": "skyfolio fly scenario.json --replanning approve --at-end return",
    "import": "skyfolio import users.csv uavs.geojson --out scenario.json",
    "keys create": "skyfolio keys create 'ground station' --role pilot",
    "keys list": "skyfolio keys list --json",
    "keys reset": "skyfolio keys reset",
    "keys revoke": "skyfolio keys revoke 3f9a1c",
    "plan": "skyfolio plan scenario.json --utility pooled --mu -0.3 --noise-dbm -84 --deadline-s 10 --out plan.json",
    "replan": "skyfolio replan plan.json --failed uav-3 --at-slot 10 --disruption-weight 5",
    "reproduce": "skyfolio reproduce --figure 2 --layouts 2 --draws 2",
    "robustness": "skyfolio robustness plan.json --wind-mps 6 --gust-mps 2 --outage-kbps 5",
    "serve": "skyfolio serve --simulate scenario.json --time-scale 5 --port 8080",
    "simulate": "skyfolio simulate --vehicles 3 --speedup 5 --duration-s 600 --fault kill:2@60",
    "status": "skyfolio status --service http://127.0.0.1:8080",
    "sweep": "skyfolio sweep study.toml --workers 4 --out out/sweep/study",
    "torture": "skyfolio torture --drills 100 --seed 1 --jobs 2",
    "tune-mu": "skyfolio tune-mu scenario.json --min-sum-rate 60 --min-jain 0.9 --plot trade-off.svg",
    "warm-up": "skyfolio warm-up --json",
}


def epilog_of(command: str) -> str | None:
    """Return what stands at the end of the `--help` of a command such as `keys create`; None without an example."""
    example = EXAMPLES.get(command)
    return None if example is None else f"\b\nExample:\n  {example}"
