"""`<material>`: global ones by name, and those written inside a visual.

As in urdfdom: a visual that names a material without defining it means the global one, and a definition inside a
visual becomes global when there is none of that name yet.
"""

from __future__ import annotations

from collections.abc import Iterable

from slidectl.description import values
from slidectl.description.report import Report
from slidectl.description.robot import Material
from slidectl.description.xml_tree import Element


class Materials:
    """The materials of one robot."""

    def __init__(self, report: Report) -> None:
        self.report = report
        self.known: dict[str, Material] = {}

    def read_global(self, elements: Iterable[Element]) -> None:
        """Take in the `<material>` children of `<robot>`."""
        for element in elements:
            material = self._read(element, values.required(element, "name", "material"))
            if material.name in self.known:
                self.report.wrong(element, "is defined twice; the first one counts")
            elif material.rgba is None and material.texture is None:
                self.report.wrong(element, "has neither <color> nor <texture>")
            self.known.setdefault(material.name, material)

    def of_visual(self, visual: Element, owner: str) -> Material | None:
        """The material of a visual, or None."""
        element = self.report.only(visual, "material")
        if element is None:
            return None
        material = self._read(element, element.get("name") or "")
        if material.rgba is not None or material.texture is not None:
            self.known.setdefault(material.name, material)
            return material
        if material.name not in self.known:
            self.report.wrong(element, f"{owner}: no material of that name is defined")
        return self.known.get(material.name, material)

    def _read(self, element: Element, name: str) -> Material:
        self.report.unknown(element, {"name"}, {"color", "texture"})
        owner = f"material {name!r}"
        color = self.report.only(element, "color")
        texture = self.report.only(element, "texture")
        if texture is not None:
            self.report.unknown(texture, {"filename"}, ())
            self.report.ignored(texture, "textures are not drawn", f"{element.title}/{texture.title}")
        return Material(name, self._rgba(color, owner), texture.get("filename") if texture is not None else None)

    def _rgba(self, color: Element | None, owner: str) -> tuple[float, float, float, float] | None:
        if color is None:
            return None
        self.report.unknown(color, {"rgba"}, ())
        red, green, blue, alpha = values.numbers(color, "rgba", 4, owner)
        if not all(0 <= part <= 1 for part in (red, green, blue, alpha)):
            self.report.wrong(color, f"{owner}: parts of a colour lie between 0 and 1")
        return red, green, blue, alpha
