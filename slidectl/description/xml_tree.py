"""Reads XML into a small tree in which every element knows its file and line, and writes it.

Entity declarations, and too large or too deep inputs, are refused; nothing is downloaded. Against: a model that was
sent, or that a client spawns. It uses expat, which gives
the line where a tag begins and can refuse entities at their declaration. In written text each tag begins its own line,
so that a line names one element. This module does not know what tags mean.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from xml.parsers import expat

from slidectl.description import source_note
from slidectl.errors import BadFile

MOST_BYTES = 16 * 1024 * 1024
MOST_ELEMENTS = 200_000
DEEPEST = 200

_MISMATCH = expat.errors.codes[expat.errors.XML_ERROR_TAG_MISMATCH]
_INVALID = expat.errors.codes[expat.errors.XML_ERROR_INVALID_TOKEN]
_ATTRIBUTE = re.compile(r"""\w+\s*=\s*["']""")

TITLES = ("reference", "name", "filename")
"""The attributes that identify elements with the same tag, in messages."""


class Comment(str):
    """The text of an XML comment, kept because a comment before a text hides it from TinyXML."""

    __slots__ = ()


@dataclass(slots=True, eq=False)
class Element:
    """One element. `content` has children, texts and comments in order; `line` is where its tag begins."""

    tag: str
    attributes: dict[str, str]
    file: str
    line: int
    content: list[Element | str] = field(default_factory=list)
    mesh_name: str | None = None
    """The `filename` of a mesh as written, when the attribute has been replaced by the file that was found."""
    folder: str = ""
    """Of a root that was read with a note: the absolute folder of the model's file."""

    @property
    def children(self) -> list[Element]:
        return [node for node in self.content if isinstance(node, Element)]

    def find_all(self, tag: str) -> list[Element]:
        """The children called `tag`."""
        return [child for child in self.children if child.tag == tag]

    def find(self, tag: str) -> Element | None:
        """The first child called `tag`."""
        return next((child for child in self.children if child.tag == tag), None)

    def remove(self, *children: Element) -> None:
        """Remove these children."""
        gone = set(map(id, children))
        self.content[:] = [node for node in self.content if id(node) not in gone]

    def get(self, name: str) -> str | None:
        """An attribute, or None."""
        return self.attributes.get(name)

    def walk(self) -> Iterator[Element]:
        """This element and all its descendants, in the order of the file."""
        pending = [self]
        while pending:
            element = pending.pop()
            yield element
            pending.extend(node for node in reversed(element.content) if isinstance(node, Element))

    @property
    def text(self) -> str:
        """Its own text, without comments and children."""
        return "".join(node for node in self.content if isinstance(node, str) and not isinstance(node, Comment))

    @property
    def first_text(self) -> str:
        """The text as in TinyXML's GetText: only the text before children and comments; blanks are condensed."""
        for node in self.content:
            if isinstance(node, (Element, Comment)):
                break
            if node.strip():
                return " ".join(node.split())
        return ""

    @property
    def stray_text(self) -> str:
        """A text directly in it that looks like attributes, as of a tag without its `<`; empty for none."""
        text = " ".join(self.text.split())
        return text if _ATTRIBUTE.search(text) else ""

    @property
    def title(self) -> str:
        """The tag in reports, with an identifying attribute."""
        for name in TITLES:
            if name in self.attributes:
                return f'<{self.tag} {name}="{self.attributes[name]}">'
        return f"<{self.tag}>"

    def set_mesh(self, file: str) -> None:
        """Replace a mesh's `filename` by the file that was found for it."""
        if self.mesh_name is None:
            self.mesh_name = self.attributes["filename"]
        self.attributes["filename"] = file

    def error(self, message: str, hint: str | None = None, kind: type[BadFile] = BadFile) -> BadFile:
        """A BadFile at this element's place, to be raised."""
        return kind(message, self.file, self.line, hint)


def below(element: Element | None, *tags: str) -> Element | None:
    """The descendant reached by the first children with these tags, one after the other; None when one is missing."""
    for tag in tags:
        element = element.find(tag) if element is not None else None
    return element


def read(source: str | bytes, file: str, most_bytes: int = MOST_BYTES) -> Element:
    """Parse an XML text and return the root element. `file` is its name in messages.

    Raises BadFile: not well-formed, an entity or document type with declarations, too large or too deep.
    """
    if len(source) > most_bytes:
        raise BadFile(f"is larger than {most_bytes // 2**20} MiB", file)
    return _Reader(file).read(source)


class _Reader:
    """Builds the tree in expat's handlers."""

    def __init__(self, file: str) -> None:
        self.file = file
        self.skipped_lines = 0
        self.count = 0
        self.root: Element | None = None
        self.open: list[Element] = []
        self.note: source_note.Note | None = None
        self.parser = expat.ParserCreate()
        self.parser.buffer_text = True
        self.parser.StartElementHandler = self.start
        self.parser.EndElementHandler = self.end
        self.parser.CharacterDataHandler = self.text
        self.parser.CommentHandler = self.comment
        self.parser.ProcessingInstructionHandler = self.instruction
        self.parser.EntityDeclHandler = self.entity
        self.parser.SkippedEntityHandler = self.skipped

    def read(self, source: str | bytes) -> Element:
        try:
            self.parser.Parse(self.without_leading_blanks(source), True)
        except expat.ExpatError as error:
            line = error.lineno + self.skipped_lines
            text = f"not well-formed XML: {expat.ErrorString(error.code)}"
            raise BadFile(text, self.file, line, self.advice(error.code, source)) from None
        except (ValueError, LookupError) as error:
            raise BadFile(f"cannot be decoded: {error}", self.file) from None
        assert self.root is not None  # expat refuses a document without an element
        if self.note is not None:
            _place(self.root, self.note)
        return self.root

    def advice(self, code: int, source: str | bytes) -> str | None:
        """A hint about frequent mistakes."""
        if code == _MISMATCH and self.open:
            return f"</{self.open[-1].tag}> is missing: its element begins in line {self.open[-1].line}"
        if code != _INVALID:
            return None
        if isinstance(source, bytes) and not is_utf8(source):
            return 'it is not UTF-8: save it as that, or begin with <?xml version="1.0" encoding="..."?>'
        return _add_mistake(source.encode() if isinstance(source, str) else source, self.parser.ErrorByteIndex)

    def without_leading_blanks(self, source: str | bytes) -> str | bytes:
        """Remove blanks before `<?xml` (such as the first line of a here-document), which XML does not allow."""
        stripped: str | bytes
        if isinstance(source, str):
            stripped = source.lstrip("\ufeff \t\r\n")
            self.skipped_lines = source[: len(source) - len(stripped)].count("\n")
        else:
            stripped = source.lstrip(b" \t\r\n")
            self.skipped_lines = source[: len(source) - len(stripped)].count(b"\n")
        return stripped

    @property
    def line(self) -> int:
        return self.parser.CurrentLineNumber + self.skipped_lines

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if self.count > MOST_ELEMENTS:
            raise BadFile(f"has more than {MOST_ELEMENTS} elements", self.file, self.line)
        if len(self.open) >= DEEPEST:
            raise BadFile(f"elements are nested deeper than {DEEPEST}", self.file, self.line)
        element = Element(tag, attributes, self.file, self.line)
        if self.open:
            self.open[-1].content.append(element)
        else:
            self.root = element
        self.open.append(element)

    def end(self, _: str) -> None:
        self.open.pop()

    def text(self, data: str) -> None:
        self.open[-1].content.append(data)

    def comment(self, data: str) -> None:
        if self.open:
            self.open[-1].content.append(Comment(data))

    def instruction(self, target: str, data: str) -> None:
        if target == source_note.TARGET:
            self.note = source_note.decode(data)

    def entity(self, name: str, *_: object) -> None:
        text = f"declares the XML entity {name!r}: entities are refused"
        raise BadFile(text, self.file, self.line, "write its text in its place")

    def skipped(self, name: str, _: bool) -> None:
        raise BadFile(f"uses the unknown XML entity {name!r}", self.file, self.line, "write its text in its place")


def _add_mistake(source: bytes, place: int) -> str | None:
    """A hint about the mistake at `place` (a byte index without leading blanks), where the syntax error is."""
    text = source.lstrip(b"\xef\xbb\xbf \t\r\n")
    before, here = text[:place], text[place : place + 1]
    if before.rfind(b"<!--") > before.rfind(b"-->"):
        return "a comment may not hold two hyphens in a row: --"
    tag = before[before.rfind(b"<") :] if before.rfind(b"<") > before.rfind(b">") else b""
    if tag and (slip := _slip_in_tag(tag.decode(errors="replace"), text[place : place + 80].decode(errors="replace"))):
        return slip
    if here == b"<":
        return "a < within a value is written &lt;"
    if here == b"&" or before.endswith(b"&"):
        return "an & is written &amp;, and && in an expression: and"
    return None


def _slip_in_tag(tag: str, rest: str) -> str | None:
    """A hint about a slip inside a tag, which is well-formed up to there; `rest` is what follows."""
    if rest[:1] in "\u201c\u201d\u201e\u2018\u2019":
        return f'values stand in plain quotation marks, not in {rest[:1]}: name="value"'
    if (name := re.search(r"([\w:.-]+)\s*=\s*\Z", tag)) is not None:
        value = re.match(r"[^\s\"'/<>]*", rest)
        shown = value[0] if value is not None and value[0] else "..."
        return f'the value of {name[1]} is not in quotation marks: {name[1]}="{shown}"'
    if (tag.count('"') + tag.count("'")) % 2:
        return None  # inside of a value
    if tag.endswith(('"', "'")) and rest[:1].strip() not in ("", "/", "<", ">"):
        last = re.search(r"([\w:.-]+)\s*=\s*[\"'][^\"']*[\"']\Z", tag)
        inside = f" in the value of {last[1]} or before it" if last is not None else ""
        return f"a quotation mark is missing{inside}, or a blank between two attributes"
    if (lone := re.fullmatch(r"<\s*(/?[\w:.-]*)(\s.*)?\s([\w:.-]+)\s*", tag, re.DOTALL)) is not None and not lone[2]:
        first, second = lone[1], lone[3]
        return f"{second!r} has no value; if it belongs to the tag's name, that has no blank: <{first}{second}>"
    if rest.startswith("<"):
        return f"a > is missing before it: the tag {tag.split()[0]} does not end"
    return None


def is_utf8(text: bytes) -> bool:
    """True when the bytes are valid UTF-8."""
    try:
        text.decode()
    except UnicodeDecodeError:
        return False
    return True


def _place(root: Element, note: source_note.Note) -> None:
    """Set the places of elements, and the files of meshes, from the note.

    A note with another number of elements belongs to another text and is ignored.
    """
    elements = list(root.walk())
    if len(elements) != len(note.places):
        return
    root.folder = note.folder
    for number, (element, (file, line)) in enumerate(zip(elements, note.places, strict=True)):
        element.file, element.line = file, line
        if number in note.meshes and element.tag == "mesh" and "filename" in element.attributes:
            element.set_mesh(note.meshes[number])


# --- writing ----------------------------------------------------------------------------------------------------------

# The standard library's escaping is in a module that imports its whole HTTP package.
_IN_TEXTS = str.maketrans({"&": "&amp;", "<": "&lt;", ">": "&gt;", "\r": "&#13;"})
_IN_ATTRIBUTES = {**_IN_TEXTS, **str.maketrans({'"': "&quot;", "\n": "&#10;", "\t": "&#9;"})}


def write(root: Element) -> str:
    """Write the tree as text, with the source note at its end.

    Comments are dropped, except beside a text, where they have an effect (see Element.first_text).
    """
    pieces = ['<?xml version="1.0" encoding="utf-8"?>\n']
    places: list[source_note.Place] = []
    meshes: dict[int, str] = {}

    def add(element: Element, indent: str) -> None:
        attributes = element.attributes
        if element.mesh_name is not None:
            meshes[len(places)] = attributes["filename"]
            attributes = {**attributes, "filename": element.mesh_name}
        places.append((element.file, element.line))
        written = "".join(f' {name}="{value.translate(_IN_ATTRIBUTES)}"' for name, value in attributes.items())
        pieces.append(f"{indent}<{element.tag}{written}")
        if element.children:
            pieces.append(">\n")
            for node in element.content:
                if isinstance(node, Element):
                    add(node, indent + "  ")
                elif not isinstance(node, Comment) and node.strip():
                    pieces.append(f"{indent}  {node.strip().translate(_IN_TEXTS)}\n")
            pieces.append(f"{indent}</{element.tag}>\n")
        elif text := _text(element):
            pieces.append(f">{text}</{element.tag}>\n")
        else:
            pieces.append("/>\n")

    add(root, "")
    return "".join(pieces) + source_note.encode(places, meshes, root.folder or _folder_of(root.file)) + "\n"


def _folder_of(file: str) -> str:
    """The absolute folder of a file; empty for a text, whose `file` is a description of where it came from."""
    absolute = os.path.abspath(file)
    return os.path.dirname(absolute) if os.path.isfile(absolute) else ""


def _text(element: Element) -> str:
    """The text of an element without children, with its comments; empty when it has no text."""
    if not element.text.strip():
        return ""
    texts = (node for node in element.content if isinstance(node, str))
    return "".join(f"<!--{text}-->" if isinstance(text, Comment) else text.translate(_IN_TEXTS) for text in texts)
