"""Readable in both themes: WCAG contrast of the colours that carry meaning."""

import re
from pathlib import Path

import pytest

from skyfolio.api.dashboard import mount

STYLE = (Path(mount.__file__).parent / "style.css").read_text()


def theme(selector: str) -> dict[str, str]:
    block = STYLE.split(f"{selector} {{", 1)[1].split("}", 1)[0]
    return dict(re.findall(r"--sf-([a-z-]+):\s*(#[0-9a-f]{6});", block))


def luminance(colour: str) -> float:
    parts = [int(colour[i : i + 2], 16) / 255 for i in (1, 3, 5)]
    linear = [part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: str, b: str) -> float:
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


@pytest.mark.parametrize("selector", [":root", "body.body--dark"])
@pytest.mark.parametrize("ink", ["text", "muted", "alarm", "warn", "ok", "idle"])
@pytest.mark.parametrize("ground", ["panel", "map"])
def test_words_stand_out(selector: str, ink: str, ground: str) -> None:
    colours = theme(selector)
    assert contrast(colours[ink], colours[ground]) >= 4.5


@pytest.mark.parametrize("selector", [":root", "body.body--dark"])
def test_uavs_stand_out_from_the_map(selector: str) -> None:
    block = STYLE.split(f"{selector} {{", 1)[1].split("}", 1)[0]
    palette = re.findall(r"#[0-9a-f]{6}", block.split("--sf-uavs:")[1].split(";")[0])
    assert len(palette) >= 6
    assert all(contrast(colour, theme(selector)["map"]) >= 2.8 for colour in palette)
