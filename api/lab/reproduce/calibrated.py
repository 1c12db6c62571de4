"""The write-up of the letter's omissions: the joint fit, numbers held out, choices that cannot be distinguished."""

from __future__ import annotations

from typing import Any

from skyfolio.api.lab.reproduce.fit import TARGETS, UNLIKELY
from skyfolio.api.lab.reproduce.markdown import figure, table, text

Found = dict[str, Any]


def calibrated(found: Found) -> str:
    """Return what `calibration.json` says, GitHub-flavoured Markdown."""
    refined = found["refined"]
    return "\n\n".join(
        [
            "## What the letter omits",
            text(
                f"""{found["settings"]} settings of all that it leaves open were flown on {len(found["layouts"])}
                layouts and set beside its {len(TARGETS)} numbers that are not ratios of others. Misfit is the root mean
                square of the relative errors, a variance counting by its square root. The best is {_best(found)}."""
            ),
            text(
                f"""Layouts differ by more than settings do, and few of them flatter whichever setting suits them: so
                {refined["settings"]} settings near the best of those with fading drawn in every slot, which
                {_share(found, "fading", "drawn per slot"):.0%} of the resamples below prefer, were flown again on
                {len(refined["layouts"])} layouts that had no part in finding them, with up to
                {refined["told_apart"]["draws"][-1]["value"]} draws. There the best is {_best(refined)}. That is what
                the study flies, with every UAV lost in turn and Baseline 2 in all readings, on layouts that neither has
                seen."""
            ),
            _numbers(refined),
            "### Held out",
            text(
                """Each number, predicted by the setting that fits the six others best; then the numbers of one kind,
                predicted by the setting that fits those of the other kind best. All on the refined settings."""
            ),
            _held_out(refined),
            _splits(refined),
            "### What the numbers cannot tell apart",
            _apart_of_all(found),
            text("Of the refined settings:"),
            _told_apart(refined),
            "### What each choice does",
            text(
                """Each varied alone, the others as in the best fit; first of the refined settings on their layouts,
                then of all settings on theirs."""
            ),
            _alone(refined),
            _alone(found),
        ]
    )


def _share(found: Found, choice: str, value: str) -> float:
    """Return in what share of resamples this value belongs to the best fit."""
    return next(float(row["best_in"]) for row in found["told_apart"][choice] if row["value"] == value)


def _best(found: Found) -> str:
    best, by_layout = found["best"], found["best_by_layout"]
    says = ", ".join(f"{_words(name)} {_shown(value)}" for name, value in best["setting"].items())
    return f"{best['misfit']:.1%} off ({says}), and on single layouts {min(by_layout):.1%} to {max(by_layout):.1%}"


def _apart_of_all(found: Found) -> str:
    intro = f"""The layouts were weighed anew many times (Bayesian bootstrap); a value is excluded when it is part of
        the best fit in fewer than {UNLIKELY:.0%} of them. One choice stands in for another: users farther away lower
        the rates as noise does, and fewer draws raise every variance. Of all settings:"""
    return text(intro) + "\n\n" + _told_apart(found)


def _words(name: str) -> str:
    return name.replace("_", " ").replace("uav", "UAV")


def _shown(value: str) -> str:
    """Return a value that may be part of a list."""
    return value.replace(", ", "-")


def _numbers(found: Found) -> str:
    fits = [found["best"], *found["next"][:3]]
    head = ("", "letter", *("best" if index == 0 else f"no. {index + 1}" for index in range(len(fits))))
    rows = [
        (name, figure(printed), *(figure(fit["numbers"][name]) for fit in fits))
        for name, printed in zip(found["best"]["numbers"], TARGETS.values(), strict=True)
    ]
    differing = [name for name in found["best"]["setting"] if len({fit["setting"][name] for fit in fits}) > 1]
    rows += [(_words(name), "-", *(_shown(fit["setting"][name]) for fit in fits)) for name in differing]
    rows.append(("misfit", "-", *(f"{fit['misfit']:.1%}" for fit in fits)))
    return table(head, rows)


def _held_out(found: Found) -> str:
    rows = [
        (row["number"], figure(row["letter"]), figure(row["predicted"]), f"{row['off']:+.0%}")
        for row in found["held_out"]
    ]
    return table(("held out", "letter", "predicted", "off (of a deviation, for a variance)"), rows)


def _splits(found: Found) -> str:
    rows = [
        (
            row["fitted_on"],
            ", ".join(map(_shown, row["setting"].values())),
            f"{row['misfit_inside']:.1%}",
            f"{row['misfit_outside']:.1%}",
        )
        for row in found["splits"]
    ]
    return table(("fitted on", "setting", "misfit there", "misfit on the rest"), rows)


def _told_apart(found: Found) -> str:
    said, excluded, rows = [], [], []
    for choice, values in found["told_apart"].items():
        left = [_shown(row["value"]) for row in values if row["best_in"] >= UNLIKELY]
        out = [_shown(row["value"]) for row in values if row["best_in"] < UNLIKELY]
        if out:
            excluded.append(f"{_words(choice)} {', '.join(out)}")
        if len(left) > 1:
            said.append(f"{_words(choice)} ({', '.join(left)})")
        rows += [
            (_words(choice), _shown(row["value"]), f"{row['misfit']:.1%}", f"{row['best_in']:.0%}") for row in values
        ]
    says = (
        f"""Excluded by the numbers: {"; ".join(excluded) or "nothing"}. Left open: {"; ".join(said) or "nothing"}."""
    )
    head = ("choice", "value", "best misfit with it", "in the best fit of resamples")
    return text(says) + "\n\n" + table(head, rows)


def _alone(found: Found) -> str:
    columns = list(found["best"]["numbers"])
    rows = [
        (
            "as calibrated",
            *(figure(found["best"]["numbers"][name]) for name in columns),
            f"{found['best']['misfit']:.1%}",
        )
    ]
    rows += [
        (
            f"{_words(row['choice'])}: {_shown(row['value'])}",
            *(figure(row["numbers"][name]) for name in columns),
            f"{row['misfit']:.1%}",
        )
        for row in found["alone"]
    ]
    return table(("choice", *columns, "misfit"), rows)
