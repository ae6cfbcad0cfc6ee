# SPDX-License-Identifier: GPL-3.0-or-later
"""What `make -C evidence faults`, `fuzz`, `sanitize`, `soak` and `coverage` found, kept for docs/reliability.md."""

from __future__ import annotations

import json
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
KEPT = ROOT / "build" / "reports" / "long_runs.json"
sys.path.append(str(ROOT / "evidence"))

from measured import measured_at  # noqa: E402


def found() -> dict[str, dict[str, dict]]:
    """Command -> part of it -> figures, and the commit that they were measured at."""
    return json.loads(KEPT.read_text(encoding="utf-8")) if KEPT.exists() else {}


def keep(command: str, part: str, **figures) -> None:
    """Replaces what an earlier run said of that part."""
    all_found = found()
    all_found.setdefault(command, {})[part] = {"measured": measured_at("reliability.md"), **figures}
    KEPT.parent.mkdir(parents=True, exist_ok=True)
    new = KEPT.with_suffix(".new")
    new.write_text(json.dumps(all_found, indent=1) + "\n", encoding="utf-8")
    new.replace(KEPT)
