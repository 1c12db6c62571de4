"""Figures by matplotlib, which is an extra (`skyfolio[plots]`) and is only imported where something is drawn."""

from __future__ import annotations

import io
from typing import TYPE_CHECKING

from skyfolio.api.common import extras

if TYPE_CHECKING:
    from matplotlib.figure import Figure


COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")
MARKERS = "osD^vPX*"


def new_figure(width_inches: float, height_inches: float) -> Figure:
    """Return an empty figure. Raises MissingExtraError without matplotlib."""
    extras.require("matplotlib", "drawing")
    from matplotlib.figure import Figure  # noqa: PLC0415

    return Figure(figsize=(width_inches, height_inches), layout="constrained")


def as_svg(figure: Figure) -> str:
    """Return the figure as an `<svg>` element, the same text for the same figure."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG  # noqa: PLC0415

    sink = io.StringIO()
    FigureCanvasSVG(figure).print_svg(sink, metadata={"Date": None})  # type: ignore[no-untyped-call]
    text = sink.getvalue()
    return text[text.index("<svg") :]
