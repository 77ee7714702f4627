"""Properties and macros that a xacro file makes and nobody uses: they leave no trace in the robot.

Looks at the files as they are written, and evaluates nothing. Only of the model's own file, not of what it includes:
a library is there to be used in part.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence

from slidectl.check.findings import Findings
from slidectl.description.xml_tree import Comment, Element

_EXPRESSION = re.compile(r"\$\{(.*?)\}", re.DOTALL)
_WORD = re.compile(r"[A-Za-z_]\w*")


def tell(trees: Sequence[Element], findings: Findings) -> None:
    """Findings on the first of some trees, which includes the others."""
    used = set(_used(element for tree in trees for element in tree.walk()))
    for element in trees[0].walk():
        name = (element.get("name") or "").removeprefix("xacro:")
        if element.tag == "xacro:property" and name not in used:
            findings.add("ignored", element.title, "no expression uses it", element.file, element.line)
        elif element.tag == "xacro:macro" and f"xacro:{name}" not in used:
            findings.add("ignored", element.title, "is never called", element.file, element.line)


def _used(elements: Iterable[Element]) -> Iterator[str]:
    """Tags, and the words of expressions, of macros' parameters, and of calls by name."""
    for element in elements:
        yield element.tag
        if element.tag == "xacro:insert_block":
            yield element.get("name") or ""
        elif element.tag == "xacro:call":
            yield f"xacro:{element.get('macro')}"
        elif element.tag == "xacro:macro":
            yield from _WORD.findall(element.get("params") or "")
        texts = (node for node in element.content if isinstance(node, str) and not isinstance(node, Comment))
        for text in (*element.attributes.values(), *texts):
            for expression in _EXPRESSION.findall(text):
                yield from _WORD.findall(expression)
