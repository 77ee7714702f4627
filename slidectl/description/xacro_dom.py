"""The bridge between our elements and the minidom nodes that xacro works on.

Nodes remember where they were written, and xacro's clones of them do too: so every element of the expanded robot
leads back to its line, through macros and includes.
"""

from __future__ import annotations

from typing import Any
from xml.dom import minidom

from slidectl.description.xml_tree import Comment, Element


class LocatedElement(minidom.Element):
    """A minidom element with the file and line of its tag."""

    def __init__(self, tag: str, file: str, line: int) -> None:
        super().__init__(tag)
        self.file = file
        self.line = line

    def cloneNode(self, deep: bool) -> LocatedElement:  # noqa: N802 (the DOM's name)
        """A copy with the same place; minidom's own cloning would forget it."""
        clone = LocatedElement(self.tagName, self.file, self.line)
        clone.ownerDocument = self.ownerDocument
        for name, value in self.attributes.items():
            _set(clone, name, value)
        for child in self.childNodes if deep else ():
            _append(clone, child.cloneNode(deep))
        return clone


def _set(node: minidom.Element, name: str, value: str) -> None:
    """Set an attribute; without a namespace of its own, minidom takes `xacro:name` and `name` for one."""
    prefix, colon, _ = name.partition(":")
    if colon:
        node.setAttributeNS(prefix, name, value)
    else:
        node.setAttribute(name, value)


def _append(parent: minidom.Element, child: Any) -> None:
    parent.appendChild(child)


def to_document(root: Element) -> minidom.Document:
    """A minidom document of located elements."""
    document = minidom.Document()
    document.appendChild(_to_node(root, document))
    return document


def _to_node(element: Element, document: minidom.Document) -> LocatedElement:
    node = LocatedElement(element.tag, element.file, element.line)
    node.ownerDocument = document
    for name, value in element.attributes.items():
        _set(node, name, value)
    for part in element.content:
        if isinstance(part, Element):
            _append(node, _to_node(part, document))
        elif isinstance(part, Comment):
            _append(node, document.createComment(part))
        else:
            _append(node, document.createTextNode(part))
    return node


def to_element(node: LocatedElement) -> Element:
    """The elements of a located node, after xacro has worked on it."""
    element = Element(node.tagName, dict(node.attributes.items()), node.file, node.line)
    for child in node.childNodes:
        if isinstance(child, LocatedElement):
            element.content.append(to_element(child))
        elif isinstance(child, minidom.Comment):
            element.content.append(Comment(child.data))
        elif isinstance(child, minidom.Text):
            element.content.append(child.data)
    return element
