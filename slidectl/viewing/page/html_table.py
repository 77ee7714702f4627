"""A table of a panel, as HTML: names may hold what HTML would take. And the style of what may be long."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

PADDING = "padding:0.2em 0.7em"
"""Of HTML in a panel, so that it stands below the inputs."""
_TABLE = "width:100%;font-size:0.8em;font-variant-numeric:tabular-nums;overflow-wrap:anywhere"
_LONGEST_WORD = 12
"""Letters of a cell that is never broken."""
HIGHEST = "max-height:50vh;overflow:auto"
"""Of what may be long."""
SCROLLED = f"{HIGHEST};{PADDING};font-size:0.8em;white-space:pre-wrap;overflow-wrap:anywhere"
"""Of text that may be long."""


def html_table(columns: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Numbers stand on the right, with four decimals; None, as NaN comes from the daemon, is a dash."""
    lines = [list(row) for row in rows]
    is_number = [bool(lines) and (one is None or isinstance(one, float)) for one in (*lines, columns)[0]]
    head = "".join(map(_cell, columns, is_number, ["th"] * len(columns)))
    body = "".join(f"<tr>{''.join(map(_cell, line, is_number, ['td'] * len(line)))}</tr>" for line in lines)
    text = f"<tr>{head}</tr>{body}"
    return f'<div style="{PADDING}"><table style="{_TABLE}">{text}</table></div>'


def _cell(value: object, is_number: bool, kind: str) -> str:
    text = "–" if value is None else f"{value:z.4f}" if isinstance(value, float) else str(value)
    wrap = "nowrap" if len(text) <= _LONGEST_WORD else "normal"
    style = f"text-align:{'right' if is_number else 'left'};white-space:{wrap}"
    return f'<{kind} style="{style}">{escape(text)}</{kind}>'
