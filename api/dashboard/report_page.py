"""The report of a drill as one self-contained HTML file, without scripts or requests. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from html import escape

from skyfolio.api.dashboard.map_scene import PALETTE
from skyfolio.api.dashboard.report import Rate, Report

ALARM = "#b84a00"
GREY = "#6b7783"
STYLE = (
    "body{font:15px/1.5 system-ui,sans-serif;max-width:1000px;margin:2em auto;padding:0 1em;color:#17202a}"
    "table{border-collapse:collapse;margin:1em 0}th,td{padding:.3em .9em;border-bottom:1px solid #ccc;text-align:left;"
    "font-weight:400}thead th{font-weight:600}figure{margin:1.5em 0}svg{max-width:100%;height:auto}"
    "figcaption{color:#566270}.good{color:#00795a}.bad{color:#b84a00}"
)
Point = tuple[float, float]


def page(report: Report) -> str:
    """Return the whole file."""
    head = "".join(f"<th>{escape(name)}</th>" for name in report.head)
    rows = "".join(_row(row) for row in report.rows)
    steps = "".join(_row(step) for step in report.steps)
    recovery = f"<h2>Recovery</h2><table>{steps}</table>" if steps else ""
    verdict = f"<p class={'good' if report.recovered else 'bad'}><b>{escape(report.verdict)}</b></p>"
    return (
        "<!doctype html><html lang='en'><head><meta charset='utf-8'>"
        f"<meta name='viewport' content='width=device-width'><title>{escape(report.title)}</title>"
        f"<style>{STYLE}</style></head><body><h1>{escape(report.title)}</h1>{verdict}"
        f"<p>Operation {escape(report.operation_id)}. Rates are computed from the positions that vehicles reported; "
        "slots count from 0. The last column is computed for survivors that fly the first plan to its end.</p>"
        f"<table><thead><tr>{head}</tr></thead>{rows}</table>{recovery}"
        f"<figure>{map_svg(report)}<figcaption>Planned (dashed) and flown (solid) tracks; users as squares; a cross "
        "where a lost UAV was last heard.</figcaption></figure>"
        f"<figure>{rates_svg(report)}<figcaption>Sum rate in each slot: flown, and without a recovery (dashed, "
        "computed); vertical lines mark losses.</figcaption></figure></body></html>"
    )


def map_svg(report: Report, width: float = 640.0) -> str:
    """Draw planned and flown tracks over the area."""
    scenario = report.plans[0].scenario
    (west, south), (east, north) = scenario.area_m
    scale = width / (east - west)
    height = (north - south) * scale

    def at(point: Point) -> Point:
        return round((point[0] - west) * scale, 1), round((north - point[1]) * scale, 1)

    parts = [f"<rect width='{width:g}' height='{height:g}' fill='#f7f9fb' stroke='{PALETTE[0]}' stroke-width='2'/>"]
    for user in scenario.users:
        x, y = at(user.position_m)
        parts.append(f"<rect x='{x - 4:g}' y='{y - 4:g}' width='8' height='8' fill='#555'/>")
    for number, uav in enumerate(scenario.uav_ids):
        colour = PALETTE[number % len(PALETTE)]
        planned = [plan.trajectories_m.get(uav, []) for plan in report.plans]
        parts += [_line(map(at, path), colour, 1.5, "6 4") for path in planned]
        track = report.tracks_m.get(uav, [])
        parts.append(_line(map(at, track), colour, 3))
        if not track:
            continue
        x, y = at(track[-1])
        if uav in report.lost_at_slot:
            parts.append(f"<path d='M{x - 8:g} {y - 8:g}l16 16m0 -16l-16 16' stroke='{ALARM}' stroke-width='3'/>")
        parts.append(_text(x + 11, y + 4, uav, colour))
    return _svg(width, height, parts)


def rates_svg(report: Report, width: float = 900.0, height: float = 260.0) -> str:
    """Draw the sum rates over the slots."""
    n = len(report.flown)
    top = max([rate for rate in (*report.flown, *report.without_recovery) if rate is not None], default=1.0) or 1.0
    left, bottom = 60.0, height - 34.0

    def x(slot: float) -> float:
        return round(left + slot * (width - left - 10) / n, 1)

    def y(rate: float) -> float:
        return round(bottom - rate / top * (bottom - 16), 1)

    parts = []
    for share in (0.0, 0.5, 1.0):
        parts.append(_line([(left, y(share * top)), (width - 10, y(share * top))], "#d3dae1", 1))
        parts.append(_text(8, y(share * top) + 4, f"{share * top / 1e3:.0f}", GREY))
    parts.append(_text(8, 12, "kbit/s", GREY))
    parts += [_text(x(slot + 0.5) - 4, height - 16, str(slot), GREY) for slot in range(0, n, max(n // 20, 1))]
    parts.append(_text(width / 2, height - 2, "slot", GREY))
    for rates, colour, dash in ((report.without_recovery, PALETTE[1], "7 4"), (report.flown, PALETTE[0], "")):
        parts.append(_line(_stairs(rates, x, y), colour, 2.5, dash))
    for uav, slot in report.lost_at_slot.items():
        parts.append(_line([(x(slot), 16), (x(slot), bottom)], ALARM, 2))
        parts.append(_text(x(slot) + 4, 26, f"{uav} lost", ALARM))
    return _svg(width, height, parts)


def _stairs(rates: Sequence[Rate], x: Callable[[float], float], y: Callable[[float], float]) -> list[Point]:
    return [
        point for n, rate in enumerate(rates) if rate is not None for point in ((x(n), y(rate)), (x(n + 1), y(rate)))
    ]


def _row(cells: Sequence[str]) -> str:
    first, *others = cells
    return (
        f"<tr><th scope='row'>{escape(first)}</th>" + "".join(f"<td>{escape(cell)}</td>" for cell in others) + "</tr>"
    )


def _line(points: Iterable[Point], colour: str, width: float, dash: str = "") -> str:
    path = " ".join(f"{x:g},{y:g}" for x, y in points)
    style = f" stroke-dasharray='{dash}'" if dash else ""
    return f"<polyline points='{path}' fill='none' stroke='{colour}' stroke-width='{width:g}'{style}/>"


def _text(x: float, y: float, words: str, colour: str) -> str:
    return f"<text x='{x:g}' y='{y:g}' font-size='12' fill='{colour}'>{escape(words)}</text>"


def _svg(width: float, height: float, parts: Iterable[str]) -> str:
    inside = "".join(parts)
    return (
        f"<svg xmlns='http://www.w3.org/2000/svg' viewBox='0 0 {width:g} {height:g}' width='{width:g}'>{inside}</svg>"
    )
