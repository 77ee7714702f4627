"""Counts the spine: the files of a command's way to the joint and back, which CONTRIBUTING.md lists in reading order.

    python scripts/spine.py

Exits with 1 when a file is missing, or when the spine is more than a person reads in an afternoon.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

ROOT = Path(__file__).parent.parent
MOST_FILES = 30
MOST_LINES = 10_000


def files() -> list[Path]:
    """The files of the list in CONTRIBUTING.md, in its order."""
    page = (ROOT / "CONTRIBUTING.md").read_text("utf-8")
    section = page.partition("## The spine")[2].partition("\n## ")[0]
    return [ROOT / "slidectl" / name for name in re.findall(r"`([a-z_0-9/]+\.py)`", section)]


def main() -> int:
    found = files()
    missing = [path for path in found if not path.is_file()]
    lines = {path: len(path.read_text("utf-8").splitlines()) for path in found if path.is_file()}
    for path, count in lines.items():
        print(f"{count:6}  {path.relative_to(ROOT)}")
    print(f"{sum(lines.values()):6}  in {len(found)} files; at most {MOST_LINES} in {MOST_FILES}")
    for path in missing:
        print(f"{path.relative_to(ROOT)} is not there", file=sys.stderr)
    return int(bool(missing) or not found or len(found) > MOST_FILES or sum(lines.values()) > MOST_LINES)


if __name__ == "__main__":
    sys.exit(main())
