"""ECharts options of the timeline, the trade-off curve and comparisons. Pure: numbers in, options out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from math import ceil
from typing import Any

from skyfolio.api.dashboard.map_scene import PALETTE

Json = dict[str, Any]
Row = Sequence[float | None]
MUTED = "#7c8896"
READABLE_ROWS = 9
"""So many names of users can be read beside their rates."""
FAINT = "rgba(124,136,150,0.28)"
ALARM = "#d55e00"
CIVIDIS = ["#00204d", "#404d6b", "#7c7b78", "#bcaf6f", "#ffea46"]
PLANNED, ACHIEVED, AFTER = PALETTE[4], PALETTE[0], PALETTE[1]


def kbps(row: Row) -> list[float | None]:
    """Convert bit/s to kbit/s; gaps stay."""
    return [None if value is None else round(value / 1e3, 3) for value in row]


def total(table: Mapping[str, Row], n_slots: int) -> list[float | None]:
    """Return the sum over users in each slot, None where any user's rate is unknown."""
    columns = ([row[n] if n < len(row) else None for row in table.values()] for n in range(n_slots))
    return [None if not column or None in column else sum(x for x in column if x is not None) for column in columns]


def timeline(
    n_slots: int,
    lines: Mapping[str, Row],
    users: Mapping[str, Row],
    *,
    cursor: int | None = None,
    lost: Mapping[str, float] | None = None,
) -> Json:
    """Return a chart of sum rates above and each user's rate in each slot below.

    Args:
        n_slots: Slots of the operation.
        lines: Sum rates by name, bit/s in each slot.
        users: Rates by user id, bit/s in each slot.
        cursor: The slot to mark.
        lost: The slot of each loss by UAV id, with fractions.
    """
    slots = [str(n) for n in range(n_slots)]
    colours = {"planned": PLANNED, "achieved": ACHIEVED, "after replan": AFTER}
    series: list[Json] = [
        {
            "name": name,
            "type": "line",
            "step": "middle",
            "symbol": "none",
            "data": kbps(row),
            "itemStyle": {"color": colours.get(name, MUTED)},
            "lineStyle": {
                "width": 3 if name == "achieved" else 2,
                "type": {"planned": [6, 4], "after replan": [2, 3]}.get(name, "solid"),
                "color": colours.get(name, MUTED),
            },
        }
        for name, row in lines.items()
    ]
    if series:
        series[0]["markLine"] = {
            "silent": True,
            "animation": False,
            "symbol": "none",
            "data": _marks(cursor, lost, n_slots),
        }
    ids = list(users)
    cells = tuple(  # not lists: the chart would watch each of thousands for changes
        (n, row, value)
        for row, user in enumerate(ids)
        for n, value in enumerate(kbps(users[user]))
        if value is not None
    )
    top = max((value for _, _, value in cells), default=1.0)
    heat = {"name": "user rate", "type": "heatmap", "xAxisIndex": 1, "yAxisIndex": 1, "data": cells, "progressive": 0}
    return {
        "animation": False,
        "tooltip": {"trigger": "item", "confine": True},
        "legend": {"top": 0, "right": 8, "data": list(lines), "textStyle": {"color": MUTED}, "itemHeight": 8},
        "grid": [
            {"left": 52, "right": 14, "top": 26, "height": "42%"},
            {"left": 52, "right": 14, "bottom": 22, "height": "27%"},
        ],
        "xAxis": [
            {**_axis("category", slots, 0), "axisLabel": {"show": False}},
            {**_axis("category", slots, 1), "name": "", "axisLabel": {"color": MUTED, "margin": 5}},
        ],
        "yAxis": [
            {**_axis("value", None, 0), "name": "sum, kbit/s", "nameTextStyle": {"color": MUTED, "align": "left"}},
            {**_axis("category", [user.replace("user-", "u") for user in ids], 1), "inverse": True,
             "axisLabel": _names_beside(len(ids))},
        ],
        "visualMap": {
            "show": False, "min": 0, "max": max(top, 1e-3), "seriesIndex": len(series), "inRange": {"color": CIVIDIS},
        },
        "series": [*series, heat],
    }  # fmt: skip


def _names_beside(rows: int) -> Json:
    """Return how the names of so many rows are written: each where there is room, else every second, third..."""
    every = ceil(rows / READABLE_ROWS)
    short = {"width": 44, "overflow": "truncate", "fontSize": 10}
    return {"color": MUTED, "interval": max(every - 1, 0), **short}


def _marks(cursor: int | None, lost: Mapping[str, float] | None, n_slots: int) -> list[Json]:
    marks: list[Json] = [
        {
            "xAxis": min(int(at), n_slots - 1),
            "lineStyle": {"color": ALARM, "width": 2, "type": "solid"},
            "label": {"formatter": f"✕ {uav} lost", "color": ALARM, "position": "insideEndTop", "fontWeight": "bold"},
        }
        for uav, at in (lost or {}).items()
    ]
    if cursor is not None:
        style = {"color": MUTED, "width": 2, "type": "solid"}
        marks.append({"xAxis": cursor, "lineStyle": style, "label": {"show": False}})
    return marks


def _axis(kind: str, data: Sequence[str] | None, grid: int) -> Json:
    return {
        "type": kind,
        "gridIndex": grid,
        "axisLabel": {"color": MUTED},
        "axisLine": {"lineStyle": {"color": FAINT}},
        "axisTick": {"show": False},
        "splitLine": {"show": kind == "value", "lineStyle": {"color": FAINT}},
        **({"data": list(data)} if data is not None else {}),
    }


def trade_off(points: Sequence[tuple[float, float, float]], chosen: float | None) -> Json:
    """Return a chart of mean sum rate over standard deviation; points are (mu, deviation, mean) in kbit/s, in order."""
    together: dict[tuple[float, float], list[float]] = {}
    for mu, deviation, mean in points:
        together.setdefault((round(deviation, 1), round(mean, 1)), []).append(mu)

    def dot(mu: float, deviation: float, mean: float) -> Json:
        mine, same = mu == chosen, together[round(deviation, 1), round(mean, 1)]
        label = f"{same[0]:g}" if len(same) == 1 else f"{same[0]:g} … {same[-1]:g}"
        return {
            "value": [round(deviation, 3), round(mean, 3)],
            "name": f"mu {mu:g}",
            "symbolSize": 15 if mine else 9,
            "itemStyle": {"color": AFTER if mine else ACHIEVED},
            "label": {"show": mu == same[0], "position": "top", "formatter": label, "color": MUTED},
        }

    return {
        "animation": False,
        "tooltip": {"formatter": "{b}: {c} kbit/s", "confine": True},
        "grid": {"left": 56, "right": 44, "top": 26, "bottom": 40},
        "xAxis": {**_axis("value", None, 0), "scale": True, "minInterval": 0.5,
                  "name": "standard deviation over slots, kbit/s",
                  "nameLocation": "middle", "nameGap": 24, "nameTextStyle": {"color": MUTED}},
        "yAxis": {**_axis("value", None, 0), "scale": True, "minInterval": 0.5, "name": "mean sum rate, kbit/s",
                  "nameTextStyle": {"color": MUTED, "align": "left"}},
        "series": [
            {"type": "line", "data": [dot(*point) for point in points], "lineStyle": {"color": FAINT, "width": 2}}
        ],
    }  # fmt: skip


def sums(lines: Mapping[str, Row], n_slots: int, *, lost: Mapping[str, float] | None = None) -> Json:
    """Return a chart of several sum rates over the slots, given in bit/s."""
    options = timeline(n_slots, lines, {}, lost=lost)
    options["series"] = options["series"][:-1]
    for number, series in enumerate(options["series"]):
        colour = PALETTE[number % len(PALETTE)]
        series["itemStyle"] = {"color": colour}
        series["lineStyle"] = {"width": 2.5, "color": colour, "type": "solid" if number == 0 else [7, 4]}
    options.pop("visualMap")
    options["grid"] = {"left": 52, "right": 14, "top": 30, "bottom": 38}
    slots = _axis("category", [str(n) for n in range(n_slots)], 0)
    label = {"name": "slot", "nameLocation": "middle", "nameGap": 22, "nameTextStyle": {"color": MUTED}}
    options["xAxis"] = {**slots, **label}
    options["yAxis"] = options["yAxis"][0]
    return options
