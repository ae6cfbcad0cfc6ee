# SPDX-License-Identifier: GPL-3.0-or-later
"""The reports of many bakes as one page: HTML for people, JSON beside it for programs. Never touches bpy."""

from __future__ import annotations

import html
import json
import math
from collections.abc import Callable
from pathlib import Path

from ..core.errors import ReportPageError
from . import disk

Check = Callable[[object], bool]

# Title -> what a cell shows of (character, bake), where there is a bake.
COLUMNS: dict[str, Callable[[dict, dict], str]] = {
    "Frames": lambda _, bake: f"{bake['frames'][0]}\u2013{bake['frames'][1]}",
    "Largest displacement, mm": lambda _, bake: f"{1000 * bake['max_displacement']:.1f}",
    "Steps/s": lambda _, bake: f"{bake['steps_per_second']:.0f}",
    "Residual": lambda _, bake: f"{bake['residual']:.1e}",
    "Energy, J": lambda _, bake: f"{bake['energy']:.3g}",
    "Inverted": lambda _, bake: str(bake["inverted"]),
    "Seconds": lambda character, _: f"{sum(character['seconds'].values()):.1f}",
    "Hash": lambda _, bake: bake["hash"][:12],
}


def _is_number(value: object) -> bool:
    """Whether it is a number that a float can hold, or NaN, which `failures` reports."""
    return type(value) is float or (type(value) is int and abs(value) < 10**300)


def _is_text(value: object) -> bool:
    return isinstance(value, str)


def _are_texts(values: object) -> bool:
    return isinstance(values, list) and all(map(_is_text, values))


def _has(**needed: Check) -> Check:
    """A check for dictionaries with at least these entries."""
    return lambda found: (
        isinstance(found, dict) and all(key in found and fits(found[key]) for key, fits in needed.items())
    )


def _are_numbers(values: object) -> bool:
    return isinstance(values, dict) and all(map(_is_number, values.values()))


# Of a report, what is read here; docs/report.md has the rest.
IS_BAKE = _has(
    frames=lambda found: isinstance(found, list) and len(found) == 2 and all(map(_is_number, found)),
    max_displacement=_is_number,
    steps_per_second=_is_number,
    residual=_is_number,
    energy=_is_number,
    inverted=_is_number,
    hash=_is_text,
)
IS_CHARACTER = _has(name=_is_text, seconds=_are_numbers, warnings=_are_texts)
IS_REPORT = _has(
    exit_code=lambda code: type(code) is int,
    error=_is_text,
    versions=lambda found: isinstance(found, dict),
    characters=lambda found: (
        isinstance(found, list)
        and all(IS_CHARACTER(each) and ("bake" not in each or IS_BAKE(each["bake"])) for each in found)
    ),
)


def read(folder: Path) -> dict[str, dict]:
    """The reports (*.json of `--report`) in a folder, by name. Raises ReportPageError."""
    reports = {}
    for path in sorted(folder.glob("*.json")):
        try:
            found = json.loads(disk.read(path).decode())
            json.dumps([[[[found]]]], indent=1)  # as deep as it is written again
            if not isinstance(found, dict) or "characters" not in found:
                continue
            if not IS_REPORT(found):
                raise ValueError("something in it is missing or of another kind")
        except (ValueError, RecursionError) as error:
            raise ReportPageError(f"'{path.name}' is no report ({error}): delete it, or run its task again") from error
        reports[path.stem] = found
    if not reports:
        raise ReportPageError(f"There are no reports in '{folder}': bake with --report first")
    return reports


def failures(reports: dict[str, dict], expected: int | None = None) -> list[str]:
    """Everything that is wrong with the reports, one per line. expected: how many there should be."""
    found = [
        f"{name}: {report['error'] or report['exit_code']}" for name, report in reports.items() if report["exit_code"]
    ]
    for name, report in reports.items():
        for character in report["characters"]:
            bake = character.get("bake", {})
            wrong = [key for key, value in bake.items() if isinstance(value, float) and not math.isfinite(value)]
            found += [f"{name}: {character['name']}: {key} is not a number" for key in wrong]
    if expected is not None and len(reports) != expected:
        found.append(f"{len(reports)} reports instead of {expected}")
    return found


def page(reports: dict[str, dict], wrong: list[str]) -> str:
    """One HTML page, complete in itself."""
    rows = [_row(name, report, character) for name, report in reports.items() for character in report["characters"]]
    rows += [f"<tr><td>{_text(name)}</td><td>failed</td></tr>" for name, r in reports.items() if not r["characters"]]
    titles = "".join(f"<th>{_text(title)}</th>" for title in ("Report", "Character", *COLUMNS, "Warnings"))
    state = "".join(f"<li>{_text(line)}</li>" for line in wrong) or "<li>All went well.</li>"
    versions = sorted({json.dumps(report["versions"]) for report in reports.values()})
    return f"""<!doctype html>
<html lang="en"><meta charset="utf-8"><title>Dynamorph bakes</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; margin: 2em; color: #222; background: #fff }}
table {{ border-collapse: collapse }} th, td {{ padding: .25em .8em; text-align: right; border-bottom: 1px solid #ddd }}
th {{ vertical-align: bottom }} td:nth-child(-n+2), td:last-child {{ text-align: left }}
</style>
<h1>Dynamorph bakes</h1>
<ul>{state}</ul>
<table><thead><tr>{titles}</tr></thead><tbody>
{chr(10).join(rows)}
</tbody></table>
<p>{"<br>".join(_text(text) for text in versions)}</p>
</html>
"""


def _row(name: str, report: dict, character: dict) -> str:
    bake = character.get("bake")
    cells = [name, character["name"]]
    cells += [show(character, bake) if bake else "" for show in COLUMNS.values()]
    cells.append("; ".join([*character["warnings"], report["error"]]).strip("; "))
    return f"<tr>{''.join(f'<td>{_text(cell)}</td>' for cell in cells)}</tr>"


def _text(text: str) -> str:
    return html.escape(str(text))
