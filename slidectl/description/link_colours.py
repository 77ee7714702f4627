"""The colours of links in pictures: from Gazebo's materials, or from the materials of their visuals."""

from __future__ import annotations

from slidectl.description.robot import Link, Shape

Colour = tuple[float, float, float, float]
"""Red, green, blue and alpha, 0 to 1."""

PLAIN: Colour = (0.7, 0.7, 0.7, 1.0)
"""The colour of a link without a material."""
_GAZEBO = {
    "Red": (1.0, 0.0, 0.0), "Green": (0.0, 1.0, 0.0), "Blue": (0.0, 0.0, 1.0), "Yellow": (1.0, 1.0, 0.0),
    "Orange": (1.0, 0.5088, 0.0468), "Purple": (1.0, 0.0, 1.0), "Turquoise": (0.0, 1.0, 1.0), "White": (1.0, 1.0, 1.0),
    "Black": (0.0, 0.0, 0.0), "DarkGrey": (0.175, 0.175, 0.175), "FlatBlack": (0.1, 0.1, 0.1), "Grey": (0.7, 0.7, 0.7),
}  # fmt: skip
"""Colours of Gazebo's materials."""


def of_link(link: Link) -> Colour:
    """The colour of a link as a whole."""
    return _of(link, link.visuals)


def of_shape(link: Link, shape: Shape) -> Colour:
    """The colour of a shape of a link. Gazebo's material of the link overrides that of the shape."""
    return _of(link, (shape,))


def _of(link: Link, shapes: tuple[Shape, ...]) -> Colour:
    named = _GAZEBO.get((link.surface.material or "").removeprefix("Gazebo/"))
    materials = [shape.material for shape in shapes if shape.material is not None]
    return (*named, 1.0) if named else next((one.rgba for one in materials if one.rgba is not None), PLAIN)
