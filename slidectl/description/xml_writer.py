"""A tree of elements back into XML text: each element's tag begins a line of its own.

So that a line of the text names one element, and the source map leads from it to the file and line where the element
was written. Comments are dropped except beside a text, where they have a meaning (see xml_tree.Element.first_text).
"""

from __future__ import annotations

from slidectl.description import source_note
from slidectl.description.xml_tree import Comment, Element

# The standard library's own escaping lives in a module that imports the whole of HTTP.
_IN_TEXTS = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"})
_IN_ATTRIBUTES = {**_IN_TEXTS, **str.maketrans({'"': "&quot;", "\n": "&#10;", "\t": "&#9;"})}

SourceMap = dict[int, tuple[str, int]]
"""Line of the text, from 1, to the file and line of the element that begins there."""


def write(root: Element) -> tuple[str, SourceMap]:
    """The text, with the note of sources at its end, and its source map."""
    writer = _Writer()
    writer.element(root, 0)
    places = list(writer.source_map.values())
    return "".join(writer.pieces) + source_note.encode(places, writer.meshes) + "\n", writer.source_map


class _Writer:
    def __init__(self) -> None:
        self.pieces = ['<?xml version="1.0" encoding="utf-8"?>\n']
        self.line = 2
        self.source_map: SourceMap = {}
        self.meshes: dict[int, str] = {}

    def put(self, text: str) -> None:
        self.pieces.append(text)
        self.line += text.count("\n")

    def element(self, element: Element, depth: int) -> None:
        indent = "  " * depth
        attributes = element.attributes
        if element.mesh_name is not None:
            self.meshes[len(self.source_map)] = attributes["filename"]
            attributes = {**attributes, "filename": element.mesh_name}
        self.source_map[self.line] = (element.file, element.line)
        self.put(f"{indent}<{element.tag}{_attributes(attributes)}")
        if element.children:
            self.put(">\n")
            self.mixed(element, depth + 1)
            self.put(f"{indent}</{element.tag}>\n")
        elif text := _text(element):
            self.put(f">{text}</{element.tag}>\n")
        else:
            self.put("/>\n")

    def mixed(self, element: Element, depth: int) -> None:
        for node in element.content:
            if isinstance(node, Element):
                self.element(node, depth)
            elif not isinstance(node, Comment) and node.strip():
                self.put("  " * depth + _escaped(node.strip()) + "\n")


def _attributes(attributes: dict[str, str]) -> str:
    return "".join(f' {name}="{value.translate(_IN_ATTRIBUTES)}"' for name, value in attributes.items())


def _text(element: Element) -> str:
    """The text of an element without children; comments stay where a text stands beside them."""
    texts = [node for node in element.content if isinstance(node, str)]
    if not any(text.strip() for text in texts if not isinstance(text, Comment)):
        return ""
    return "".join(f"<!--{text}-->" if isinstance(text, Comment) else _escaped(text) for text in texts)


def _escaped(text: str) -> str:
    return text.translate(_IN_TEXTS)
