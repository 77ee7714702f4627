"""`<link>`: inertial, visuals, collisions and their geometry.

Refuses what no body can be (mass, inertia, sizes). How links hang together is structure.py.
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

    def __init__(self, report: Report, materials: Materials, meshes: MeshFiles) -> None:
        self.report = report
        self.materials = materials
        self.meshes = meshes

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
            tuple(self._shape(child, owner) for child in element.find_all("visual")),
            tuple(self._shape(child, owner) for child in element.find_all("collision")),
            line=element.line,
            file=element.file,
        )

    def _inertial(self, element: Element, owner: str) -> Inertial:
        self.report.unknown(element, (), {"origin", "mass", "inertia"}, f"{owner}/<inertial>")
        mass_element = _child(self.report, element, "mass", owner)
        mass = values.number(mass_element, "value", owner)
        if mass <= 0:
            raise mass_element.error(f"{owner} has a mass of {mass:g} kg; it must be above 0")
        tensor_element = _child(self.report, element, "inertia", owner)
        tensor = self._tensor(tensor_element, owner)
        return Inertial(self._origin(element, owner), mass, tensor, element.line)

    def _tensor(self, element: Element, owner: str) -> inertia.Tensor:
        self.report.unknown(element, _MOMENTS, (), f"{owner}/<inertia>")
        ixx, ixy, ixz, iyy, iyz, izz = (values.number(element, name, owner) for name in _MOMENTS)
        tensor = (ixx, ixy, ixz, iyy, iyz, izz)
        if why := inertia.why_impossible(tensor):
            raise element.error(f"{owner} has an inertia that no body can have: {why}")
        return tensor

    def _origin(self, element: Element, owner: str) -> Pose:
        origin = self.report.only(element, "origin")
        if origin is not None:
            self.report.unknown(origin, {"xyz", "rpy"}, (), f"{owner}/<origin>")
        return values.pose(origin, owner)

    def _shape(self, element: Element, owner: str) -> Shape:
        is_visual = element.tag == "visual"
        known = {"origin", "geometry", "material"} if is_visual else {"origin", "geometry"}
        self.report.unknown(element, {"name"}, known, f"{owner}/<{element.tag}>")
        geometry = self._geometry(_child(self.report, element, "geometry", owner), owner, needed=not is_visual)
        material = self.materials.of_visual(element, owner) if is_visual else None
        return Shape(geometry, self._origin(element, owner), element.get("name"), material, element.line, element.file)

    def _geometry(self, element: Element, owner: str, *, needed: bool) -> Geometry:
        shapes = [child for child in element.children if child.tag in _GEOMETRIES]
        if not shapes:
            there = ", ".join(child.tag for child in element.children) or "nothing"
            raise element.error(f"{owner}: <geometry> holds {there}; known shapes: {', '.join(_GEOMETRIES)}")
        self.report.unknown(element, (), _GEOMETRIES, f"{owner}/<geometry>")
        for extra in shapes[1:]:
            self.report.ignored(extra, "only the first shape of a <geometry> counts", f"{owner}/{extra.title}")
        shape = shapes[0]
        if shape.tag == "mesh":
            return self._mesh(shape, owner, needed=needed)
        return self._primitive(shape, owner)

    def _primitive(self, shape: Element, owner: str) -> Geometry:
        attributes = {"box": {"size"}, "cylinder": {"radius", "length"}, "sphere": {"radius"}}[shape.tag]
        self.report.unknown(shape, attributes, (), f"{owner}/<{shape.tag}>")
        if shape.tag == "box":
            size = values.vector(shape, "size", owner)
            if min(size) <= 0:
                raise shape.error(f"{owner}: edges of a <box> must be above 0, not {shape.get('size')!r}")
            return Box(size)
        radius = values.positive(shape, "radius", owner)
        return Sphere(radius) if shape.tag == "sphere" else Cylinder(radius, values.positive(shape, "length", owner))

    def _mesh(self, shape: Element, owner: str, *, needed: bool) -> Mesh:
        """A mesh. One that is only looked at may be missing (it moves nothing); one that collides may not."""
        self.report.unknown(shape, {"filename", "scale"}, (), f"{owner}/<mesh>")
        uri = values.required(shape, "filename", owner)
        scale = values.vector(shape, "scale", owner) if "scale" in shape.attributes else (1.0, 1.0, 1.0)
        if 0.0 in scale:
            raise shape.error(f"{owner}: a mesh's scale must not be 0, it is {shape.get('scale')!r}")
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
