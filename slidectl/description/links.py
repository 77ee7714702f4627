"""`<link>`: inertial, visuals, collisions and their geometry.

A shape without a size is left out. What bodies can weigh is rigid_bodies.py's, how links hang together structure.py's.
"""

from __future__ import annotations

from slidectl.description import inertia, values
from slidectl.description.materials import Materials
from slidectl.description.mesh_files import SUFFIXES, MeshFiles, has_known_suffix
from slidectl.description.report import Report, one_line
from slidectl.description.robot import Box, Cylinder, Geometry, Inertial, Link, Mesh, Pose, Shape, Sphere
from slidectl.description.xml_tree import Element

_GEOMETRIES = ("box", "cylinder", "sphere", "mesh")
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")


class LinkReader:
    """Reads `<link>` elements of one robot."""

    def __init__(self, report: Report, materials: Materials, meshes: MeshFiles, strict: bool = False) -> None:
        """`strict` refuses shapes without a size."""
        self.report = report
        self.materials = materials
        self.meshes = meshes
        self.strict = strict

    def read(self, element: Element) -> Link:
        """One link.

        Raises:
            BadFile: anything that is missing, malformed or impossible.
        """
        name = values.required(element, "name", "link")
        owner = f"link {name!r}"
        self.report.unknown(element, {"name"}, {"inertial", "visual", "collision"})
        inertial = self.report.only(element, "inertial")
        return Link(
            name,
            self._inertial(inertial, owner) if inertial is not None else None,
            self._shapes(element, "visual", owner),
            self._shapes(element, "collision", owner),
            line=element.line,
            file=element.file,
        )

    def _inertial(self, element: Element, owner: str) -> Inertial:
        self.report.unknown(element, (), {"origin", "mass", "inertia"}, f"{owner}/<inertial>")
        mass_element = _child(self.report, element, "mass", owner)
        mass = values.number(mass_element, "value", owner)
        tensor_element = _child(self.report, element, "inertia", owner)
        tensor = self._tensor(tensor_element, owner)
        return Inertial(self._origin(element, owner), mass, tensor, element.line)

    def _tensor(self, element: Element, owner: str) -> inertia.Tensor:
        self.report.unknown(element, _MOMENTS, (), f"{owner}/<inertia>")
        ixx, ixy, ixz, iyy, iyz, izz = (values.number(element, name, owner) for name in _MOMENTS)
        return ixx, ixy, ixz, iyy, iyz, izz

    def _origin(self, element: Element, owner: str) -> Pose:
        origin = self.report.only(element, "origin")
        if origin is not None:
            self.report.unknown(origin, {"xyz", "rpy"}, (), f"{owner}/<origin>")
        return values.pose(origin, owner)

    def _shapes(self, link: Element, tag: str, owner: str) -> tuple[Shape, ...]:
        shapes = (self._shape(element, owner) for element in link.find_all(tag))
        return tuple(shape for shape in shapes if shape is not None)

    def _shape(self, element: Element, owner: str) -> Shape | None:
        """A visual or a collision; None when it has no size."""
        is_visual = element.tag == "visual"
        known = {"origin", "geometry", "material"} if is_visual else {"origin", "geometry"}
        self.report.unknown(element, {"name"}, known, f"{owner}/<{element.tag}>")
        inside = self.report.only(element, "geometry")
        if inside is None:
            self._leave_out(element, owner, f"<{element.tag}> lacks <geometry>")
        geometry = self._geometry(inside, owner, needed=not is_visual) if inside is not None else None
        material = self.materials.of_visual(element, owner) if is_visual else None
        origin = self._origin(element, owner)
        if geometry is None:
            return None
        return Shape(geometry, origin, element.get("name"), material, element.line, element.file)

    def _leave_out(self, element: Element, owner: str, why: str) -> None:
        """Report a shape without a size, or refuse it."""
        if self.strict:
            raise element.error(f"{owner}: {why}")
        self.report.ignored(element, f"{why}; the shape is left out", f"{owner}/{element.title}")

    def _geometry(self, element: Element, owner: str, *, needed: bool) -> Geometry | None:
        shapes = [child for child in element.children if child.tag in _GEOMETRIES]
        if not shapes:
            there = ", ".join(child.tag for child in element.children) or "nothing"
            why = f"<geometry> holds {there}; known shapes: {', '.join(_GEOMETRIES)}"
            if element.children:
                raise element.error(f"{owner}: {why}")
            self._leave_out(element, owner, why)
            return None
        self.report.unknown(element, (), _GEOMETRIES, f"{owner}/<geometry>")
        for extra in shapes[1:]:
            self.report.ignored(extra, "only the first shape of a <geometry> counts", f"{owner}/{extra.title}")
        shape = shapes[0]
        if shape.tag == "mesh":
            return self._mesh(shape, owner, needed=needed)
        return self._primitive(shape, owner)

    def _primitive(self, shape: Element, owner: str) -> Geometry | None:
        attributes = {"box": ("size",), "cylinder": ("radius", "length"), "sphere": ("radius",)}[shape.tag]
        self.report.unknown(shape, attributes, (), f"{owner}/<{shape.tag}>")
        if shape.tag == "box":
            sizes: tuple[float, ...] = values.vector(shape, "size", owner)
            if min(sizes) < 0:
                raise shape.error(f"{owner}: edges of a <box> must be above 0, not {shape.get('size')!r}")
        else:
            sizes = tuple(values.not_negative(shape, name, owner) for name in attributes)
        # The physics takes half lengths, and half of the smallest number is 0.
        if min(sizes) / 2 == 0.0:
            written = ", ".join(f"{name} {shape.get(name)!r}" for name in attributes)
            self._leave_out(shape, owner, f"<{shape.tag}> with {written} has no volume")
            return None
        if shape.tag == "box":
            return Box((sizes[0], sizes[1], sizes[2]))
        return Sphere(sizes[0]) if shape.tag == "sphere" else Cylinder(sizes[0], sizes[1])

    def _mesh(self, shape: Element, owner: str, *, needed: bool) -> Mesh | None:
        """A mesh. One that is only looked at may be missing (it moves nothing); one that collides may not."""
        self.report.unknown(shape, {"filename", "scale"}, (), f"{owner}/<mesh>")
        filename = shape.get("filename")
        if filename is not None and not filename.strip():
            self._leave_out(shape, owner, "attribute 'filename' of <mesh> is empty")
            return None
        uri = values.required(shape, "filename", owner)
        scale = values.vector(shape, "scale", owner) if "scale" in shape.attributes else (1.0, 1.0, 1.0)
        if 0.0 in scale:
            self._leave_out(shape, owner, f"<mesh> with scale {shape.get('scale')!r} has no volume")
            return None
        path, why = self.meshes.locate(uri, shape.file)
        if path is not None and not has_known_suffix(uri):
            path, why = None, f"is of no known kind; known: {', '.join(SUFFIXES)}"
        if path is None and needed:
            raise shape.error(f"{owner}: mesh {uri!r}: {why}")
        if path is None:
            self.report.wrong(shape, f"{owner} is not drawn: {one_line(why)}")
        return Mesh(uri, str(path) if path is not None else None, scale)


def _child(report: Report, element: Element, tag: str, owner: str) -> Element:
    """A mandatory child."""
    child = report.only(element, tag)
    if child is None:
        raise element.error(f"{owner}: <{element.tag}> lacks <{tag}>")
    return child
