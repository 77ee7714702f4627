"""Robots are fixed to the world, and freed from it."""

from __future__ import annotations

import pytest
from description_urdf_text import LIMIT, cart, joint, link, robot

from slidectl.description import load, parse, with_root_fixed, with_root_free
from slidectl.errors import BadFile

FREE = robot(link("base"), joint("j", parent="base", child="arm"), link("arm"))
HELD = robot(
    link("world", ""), joint("weld", "fixed", "world", "base", ""), FREE.partition("\n")[2][: -len("</robot>")]
)


def test_a_free_robot_is_fixed_at_its_root() -> None:
    bot = parse(with_root_fixed(FREE))
    assert bot.is_fixed_to_world
    (held,) = bot.children_of("world")
    assert (held.type, held.child) == ("fixed", "base")


def test_a_massless_root_may_be_fixed() -> None:
    xml = robot(link("base", ""), joint("j", parent="base", child="arm"), link("arm"))
    assert parse(with_root_fixed(xml)).is_fixed_to_world


def test_a_fixed_robot_stays_as_it_is() -> None:
    assert with_root_fixed(cart()) == cart()


def test_the_new_joint_takes_a_name_that_is_free() -> None:
    xml = FREE.replace('name="j"', 'name="world_to_root"')
    assert list(parse(with_root_fixed(xml)).joints) == ["world_to_root", "world_to_root_"]


def test_a_held_robot_is_freed_of_its_world_link() -> None:
    bot = parse(with_root_free(HELD))
    assert bot.root == "base"
    assert list(bot.joints) == ["j"]


def test_a_free_robot_stays_as_it_is() -> None:
    assert with_root_free(FREE) == FREE


def test_fixing_undoes_freeing_and_lines_stay_those_of_the_file() -> None:
    document = load("rrbot")
    freed = parse(with_root_free(document.xml))
    fixed = parse(with_root_fixed(with_root_free(document.xml)))
    original = parse(document.xml)
    assert freed.links["link3"] == original.links["link3"]
    assert fixed.links["link3"] == original.links["link3"]
    assert fixed.report == original.report


@pytest.mark.parametrize(
    "xml",
    [
        cart(),
        robot(link("world", ""), link("a"), link("b"), joint("j", "fixed", child="a"), joint("k", "fixed", child="b")),
    ],
)
def test_a_world_that_holds_a_robot_by_more_than_one_fixed_joint_stays(xml: str) -> None:
    with pytest.raises(BadFile, match="by one fixed joint alone; joints there: "):
        with_root_free(xml)


def test_a_link_called_world_that_is_not_the_root_cannot_be_the_world() -> None:
    xml = robot(link("base"), joint("j", parent="base", child="world", inside=LIMIT), link("world"))
    with pytest.raises(BadFile, match="cannot fix the robot"):
        with_root_fixed(xml)


@pytest.mark.parametrize("change", [with_root_fixed, with_root_free])
@pytest.mark.parametrize("xml", [robot(), robot(link("a"), link("b")), "<robot", robot("<link/>")])
def test_what_has_no_single_root_is_refused(change: type, xml: str) -> None:
    with pytest.raises(BadFile):
        change(xml)
