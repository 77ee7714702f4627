"""Combines links that fixed joints connect into one body, and checks and corrects its mass and inertia.

As in Gazebo, a link on a fixed joint may have no mass, or an impossible inertia, as long as the whole body can be
simulated. Other bodies are corrected, with a notice.
inertia.py knows which masses and inertias are possible; parser.py checks the tree of links.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

from slidectl.description import inertia
from slidectl.description.inertia import LEAST, Tensor
from slidectl.description.report import Report
from slidectl.description.robot import Inertial, Joint, Link, Pose, Robot, Vector
from slidectl.description.xml_tree import Element
from slidectl.errors import listing
from slidectl.rotations import Matrix, from_rpy, matrix

WORLD = "world"

LARGEST = 1e300
"""kg, kg·m² and m. Up to here, sums and products for a whole body stay finite."""

_MOMENTS = "ixx ixy ixz iyy iyz izz"


@dataclass(frozen=True)
class RigidBody:
    """Links that fixed joints connect."""

    links: tuple[str, ...]
    """The head first, then each link after its parent. The head is the only link whose parent joint is not fixed."""
    mover: Joint | None
    """The joint that moves the head; None for the root body."""

    @property
    def head(self) -> str:
        return self.links[0]

    @property
    def moves(self) -> bool:
        """False for a body that is fixed to the world."""
        return self.mover is not None or self.head != WORLD


def lumped(parts: Sequence[tuple[Inertial, Matrix, Vector]]) -> Inertial:
    """Combine links into one body: its mass, centre of mass and the inertia about it, in the frame of the body.

    Each part has a link's inertial, and the link's rotation and position in that frame. Masses are added, and so are
    the tensors, rotated into the frame and shifted by Steiner's theorem; negative values too, as in Gazebo.
    """
    made = [_Part(*part) for part in parts]
    mass = sum(part.mass for part in made)
    if mass < LEAST:
        centre, about = (0.0, 0.0, 0.0), [part.tensor for part in made]
    else:
        x, y, z = (sum(part.mass * part.centre[i] for part in made) / mass for i in range(3))
        centre = (x, y, z)
        about = [part.about(centre) for part in made]
    ixx, ixy, ixz, iyy, iyz, izz = (sum(values) for values in zip(*about, strict=True))
    return Inertial(Pose(centre), mass, (ixx, ixy, ixz, iyy, iyz, izz), parts[0][0].line)


def rigid_bodies(root: str, joints: Mapping[str, Joint]) -> list[RigidBody]:
    """All bodies of a robot, that of the root first. Takes time linear in the number of joints."""
    welded: dict[str, list[str]] = {}
    for joint in joints.values():
        if joint.type == "fixed":
            welded.setdefault(joint.parent, []).append(joint.child)
    bodies = []
    movers = (joint for joint in joints.values() if joint.type != "fixed")
    for head, mover in [(root, None), *((joint.child, joint) for joint in movers)]:
        links = [head]
        for link in links:  # the loop appends to the list
            links.extend(welded.get(link, ()))
        bodies.append(RigidBody(tuple(links), mover))
    return bodies


def why_unfit(inertial: Inertial) -> str | None:
    """Why no body can have a link's mass and inertia, as a clause; None when one can."""
    if not inertia.is_mass(inertial.mass):
        return f"has a mass of {inertial.mass:g} kg; it must be above 0"
    why = inertia.why_impossible(inertial.inertia)
    return None if why is None else f"has an inertia that no body can have: {why}"


def can_be_simulated(body: RigidBody, links: Mapping[str, Link]) -> bool:
    """True when no link is unfit and, if the body moves, some link has enough mass and inertia for the whole body."""
    weighing = [inertial for link in body.links if (inertial := links[link].inertial) is not None]
    if any(why_unfit(inertial) for inertial in weighing):
        return False
    return not body.moves or any(inertia.can_move(inertial.mass, inertial.inertia) for inertial in weighing)


@dataclass(frozen=True)
class _ImpossibleInertial:
    """A link with an impossible mass or inertia, and the tag below `<inertial>` that has it."""

    link: str
    tag: str
    place: Element
    why: str

    def report_to(self, report: Report, consequence: str) -> None:
        report.converted(self.place, f"{self.why}; {consequence}", f"{_subject(self.link)}/<{self.tag}>")


@dataclass
class InertiaCorrector:
    """Corrects the bodies of one robot, with a notice for each link that cannot be simulated as written."""

    links: dict[str, Link]
    joints: Mapping[str, Joint]
    link_at: Mapping[str, Element]
    report: Report
    strict: bool = False
    """True: refuse what would be corrected."""

    def __post_init__(self) -> None:
        self._above = {joint.child: joint for joint in self.joints.values()}

    def weigh(self, root: str) -> dict[str, Link]:
        """The links, with inertias that can be simulated; those of correct bodies are unchanged.

        Raises BadFile: the sums overflow; or, with `strict`, anything needs a correction.
        """
        for body in rigid_bodies(root, self.joints):
            self.report.attempt(self._weigh, self.link_at[body.head], body)
        return self.links

    def _weigh(self, _: Element, body: RigidBody) -> bool:
        if not can_be_simulated(body, self.links):
            unfit = list(self._unfit(body))
            if self.strict and unfit:
                raise unfit[0].place.error(f"link {unfit[0].link!r} {unfit[0].why}")
            if not body.moves:
                for found in unfit:
                    found.report_to(self.report, "it is fixed to the world, where nothing has a weight")
                    self.links[found.link] = replace(self.links[found.link], inertial=None)
            elif (written := self._lumped(body)) is not None:
                self._mend(body, written, unfit)
            else:
                self._give_least(body)
        elif len(body.links) > 1 and (whole := self._lumped(body)) is not None:
            self._refuse_too_large(body, whole)
        return True

    def _refuse_too_large(self, body: RigidBody, whole: Inertial) -> None:
        """Raise BadFile when the body's sums are too large for later arithmetic, although each link is possible."""
        if not all(abs(part) <= LARGEST for part in (whole.mass, *whole.inertia, *whole.origin.xyz)):
            raise self.link_at[body.head].error(f"link {body.head!r}: its masses or inertias are too large")

    def _mend(self, body: RigidBody, written: Inertial, unfit: Sequence[_ImpossibleInertial]) -> None:
        mass, moments = inertia.nearest_possible(written.mass, written.inertia)
        mended = replace(written, mass=mass, inertia=moments)
        self._refuse_too_large(body, mended)
        weighing = [link for link in body.links if self.links[link].inertial is not None]
        change = _change(written, mended)
        whole = "it is" if len(weighing) == 1 else f"fixed to one another, {listing(weighing)} are"
        end = f"simulated with {change}" if change else f"one body of {_weight(mended)}"
        for found in unfit:
            found.report_to(self.report, f"{whole} {end}")
        if not unfit:
            place = self._inertial_of(weighing[0])
            text = f"{_weight(written)} are too small for a body that moves"
            if self.strict:
                raise place.error(f"link {weighing[0]!r}: {text}; both must be at least {LEAST:g}")
            self.report.converted(place, f"{text}; {whole} simulated with {change}", _subject(weighing[0]))
        for link in weighing:
            self.links[link] = replace(self.links[link], inertial=None)
        target_link = weighing[0] if len(weighing) == 1 else body.head
        self.links[target_link] = replace(self.links[target_link], inertial=mended)

    def _give_least(self, body: RigidBody) -> None:
        """Give a moving body that has no mass at all the smallest mass and inertia."""
        place = self.link_at[body.head]
        who = f"moved by joint {body.mover.name!r}," if body.mover is not None else "the root,"
        why = f"{who} has no <inertial>, nor has a link fixed to it"
        hint = "give it an <inertial> with <mass> and <inertia>" + ("" if body.mover else ", or hold it with --fixed")
        if self.strict:
            raise place.error(f"link {body.head!r}, {why}", hint)
        moment = inertia.SMALLEST_MOMENT
        given = Inertial(Pose(), inertia.SMALLEST_MASS, (moment, 0.0, 0.0, moment, 0.0, moment), mended=True)
        self.report.wrong(place, f"{why}; {hint}. It is simulated with {_weight(given)}", f"link {body.head!r}")
        self.links[body.head] = replace(self.links[body.head], inertial=given)

    def _unfit(self, body: RigidBody) -> Iterator[_ImpossibleInertial]:
        for link in body.links:
            inertial = self.links[link].inertial
            why = why_unfit(inertial) if inertial is not None else None
            if inertial is not None and why is not None:
                tag = "inertia" if inertia.is_mass(inertial.mass) else "mass"
                above = self._inertial_of(link)
                yield _ImpossibleInertial(link, tag, above.find(tag) or above, why)

    def _inertial_of(self, link: str) -> Element:
        element = self.link_at[link]
        return element.find("inertial") or element

    def _lumped(self, body: RigidBody) -> Inertial | None:
        """The inertial of a whole body in the head's frame; None when no link has one.

        The only inertial of a body is returned as written, in its own link's frame.
        """
        weighing = [(link, inertial) for link in body.links if (inertial := self.links[link].inertial) is not None]
        if not weighing:
            return None
        first = weighing[0][1]
        if len(weighing) == 1:
            return replace(first, mended=True)
        # Rotation and position of each link in the frame of the head; each link comes after its parent.
        seen: dict[str, tuple[Matrix, Vector]] = {body.head: (matrix(from_rpy((0.0, 0.0, 0.0))), (0.0, 0.0, 0.0))}
        for link in body.links[1:]:
            joint = self._above[link]
            turn, shift = seen[joint.parent]
            placed = _moved(turn, joint.origin.xyz, shift)
            seen[link] = _product(turn, matrix(from_rpy(joint.origin.rpy))), placed
        return replace(lumped([(inertial, *seen[link]) for link, inertial in weighing]), mended=True)


class _Part:
    """The contribution of one link to a body, in the head's frame."""

    def __init__(self, inertial: Inertial, turn: Matrix, shift: Vector) -> None:
        self.mass = inertial.mass
        self.centre = _moved(turn, inertial.origin.xyz, shift)
        axes = _product(turn, matrix(from_rpy(inertial.origin.rpy)))
        ixx, ixy, ixz, iyy, iyz, izz = inertial.inertia
        rows = _product(_product(axes, ((ixx, ixy, ixz), (ixy, iyy, iyz), (ixz, iyz, izz))), _transposed(axes))
        self.tensor: Tensor = (rows[0][0], rows[0][1], rows[0][2], rows[1][1], rows[1][2], rows[2][2])

    def about(self, centre: Vector) -> Tensor:
        """Its inertia tensor about another point."""
        x, y, z = (own - other for own, other in zip(self.centre, centre, strict=True))
        m, (ixx, ixy, ixz, iyy, iyz, izz) = self.mass, self.tensor
        return (
            ixx + m * (y * y + z * z), ixy - m * x * y, ixz - m * x * z,
            iyy + m * (x * x + z * z), iyz - m * y * z, izz + m * (x * x + y * y),
        )  # fmt: skip


def _subject(link: str) -> str:
    return f"link {link!r}/<inertial>"


def _weight(inertial: Inertial) -> str:
    moments = ", ".join(f"{moment:.4g}" for moment in inertia.principal_moments(inertial.inertia))
    return f"{inertial.mass:.4g} kg and principal moments {moments} kg·m²"


def _change(before: Inertial, after: Inertial) -> str:
    """Old and new values of what was corrected; empty when nothing was."""
    parts = []
    if after.mass != before.mass:
        parts.append(f"a mass of {after.mass:g} instead of {before.mass:g} kg")
    if after.inertia != before.inertia:
        parts.append(f"{_MOMENTS} of {_row(after.inertia)} instead of {_row(before.inertia)} kg·m²")
    return " and ".join(parts)


def _row(tensor: Tensor) -> str:
    return " ".join(f"{part:.6g}" for part in tensor)


def _moved(turn: Matrix, point: Vector, shift: Vector) -> Vector:
    x, y, z = (sum(a * b for a, b in zip(row, point, strict=True)) for row in turn)
    return (x + shift[0], y + shift[1], z + shift[2])


def _product(a: Matrix, b: Matrix) -> Matrix:
    x, y, z = (_moved(_transposed(b), row, (0.0, 0.0, 0.0)) for row in a)
    return x, y, z


def _transposed(rows: Matrix) -> Matrix:
    x, y, z = zip(*rows, strict=True)
    return x, y, z


def surroundings(robot: Robot) -> set[str]:
    """The links that are fixed to the world and no parts of a machine: all of a model without moving parts.

    Of a model with moving parts they are the links without mass: a table in the file of the arm that stands on it.
    """
    bodies = rigid_bodies(robot.root, robot.joints)
    fixed = {link for body in bodies if not body.moves for link in body.links}
    if all(not body.moves for body in bodies):
        return fixed
    return {link for link in fixed if robot.links[link].inertial is None}
