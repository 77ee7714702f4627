"""xacro runs with our arguments and packages, and every element of its result knows where it was written."""

from __future__ import annotations

import inspect
import os
import sys
import zlib
from collections.abc import Callable
from pathlib import Path

import pytest
import xacro
from description_urdf_text import INERTIAL, joint, link
from xacro import substitution_args

from slidectl.description import load, parse, takes_namespace, written
from slidectl.errors import BadFile

Write = Callable[[str, str], Path]

XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'


def model(*parts: str) -> str:
    """A xacro robot; its first part stands in line 2."""
    return "\n".join([f'<robot name="bot" {XACRO}>', *parts, "</robot>"])


BAR = f"""<robot {XACRO}>
  <xacro:macro name="bar" params="name mass *place">
    <link name="${{name}}">
      <inertial>
        <xacro:insert_block name="place"/>
        <mass value="${{mass}}"/>
        <inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"
                 izz="1" colour="red"/>
      </inertial>
    </link>
  </xacro:macro>
</robot>"""


@pytest.fixture
def package(write: Write) -> Path:
    """A package whose folder has blanks and letters beyond ASCII in its name; its model uses two files."""
    write("roboter für alle/package.xml", "<package><name>my_robot</name></package>")
    write("roboter für alle/urdf/bar.xacro", BAR)
    return write(
        "roboter für alle/urdf/main.xacro",
        model(
            '<xacro:include filename="$(find my_robot)/urdf/bar.xacro"/>',
            '<xacro:arg name="mass" default="2"/>',
            "<link name='world'/>",
            "<xacro:bar name='arm' mass='$(arg mass)'>",
            '  <origin xyz="0 0 ${0.5 * 3}" colour="red"/>',
            "</xacro:bar>",
            joint(child="arm"),
        ),
    )


def test_a_model_is_expanded_through_macros_and_includes(package: Path) -> None:
    bot = parse(load(package).xml)
    inertial = bot.links["arm"].inertial
    assert inertial is not None
    assert (inertial.mass, inertial.origin.xyz) == (2.0, (0.0, 0.0, 1.5))


def test_arguments_replace_their_defaults(package: Path) -> None:
    inertial = parse(load(package, {"mass": "7"}).xml).links["arm"].inertial
    assert inertial is not None
    assert inertial.mass == 7.0


def test_notices_name_the_file_and_line_where_the_tag_was_written(package: Path) -> None:
    bot = parse(load(package).xml)
    places = {Path(notice.file).name: notice.line for notice in bot.report}
    assert places == {"bar.xacro": 7, "main.xacro": 6}


def test_an_error_in_an_expanded_robot_names_the_line_of_the_macro(package: Path) -> None:
    with pytest.raises(BadFile, match="'arm' has a mass of -1 kg") as caught:
        parse(load(package, {"mass": "-1"}).xml, strict=True)
    assert (Path(str(caught.value.file)).name, caught.value.line) == ("bar.xacro", 6)


def test_an_argument_that_the_file_does_not_know_is_reported(package: Path) -> None:
    (notice,) = load(package, {"mass": "1", "wieght": "2"}).report
    assert notice.subject == "wieght:="
    assert "arguments: mass" in notice.text


def test_declared_arguments_are_read_from_the_file_and_its_includes(write: Write, package: Path) -> None:
    write("more.xacro", f'<robot {XACRO}><xacro:arg name="colour" default="red"/></robot>')
    main = write(
        "main.xacro",
        model(
            '<xacro:include filename="more.xacro"/>',
            '<xacro:include filename="${name}.xacro"/>',
            '<xacro:include filename="missing.xacro"/>',
            '<xacro:include filename="main.xacro"/>',
            '<xacro:arg name="namespace" default="/bot"/>',
        ),
    )
    arguments = {name: argument.get("default") for name, argument in written(main).arguments.items()}
    assert arguments == {"colour": "red", "namespace": "/bot"}
    assert list(written(package).arguments) == ["mass"]


@pytest.mark.parametrize("name", ["bot.xacro", "bot.xacro.urdf", "bot.URDF.XACRO"])
def test_a_file_with_xacro_in_its_suffixes_is_expanded_without_a_tag_of_xacro(write: Write, name: str) -> None:
    assert '<link name="ab"' in load(write(name, "<robot name='bot'><link name=\"${'a' + 'b'}\"/></robot>")).urdf


@pytest.mark.parametrize(("name", "takes"), [("arm", True), ("${namespace}arm", False), ("$(arg namespace)arm", False)])
def test_a_namespace_that_begins_the_names_of_links_is_none_of_the_graph(write: Write, name: str, takes: bool) -> None:
    argument = '<xacro:arg name="namespace" default=""/><xacro:property name="namespace" value="$(arg namespace)"/>'
    assert takes_namespace(write("main.xacro", model(argument, f'<link name="{name}"/>'))) is takes
    assert not takes_namespace(write("main.xacro", model(f'<link name="{name}"/>')))


FAULTS = [
    ("<link name='${foo}'/>", "name 'foo' is not defined, when evaluating expression 'foo'"),
    ("<link name='$(arg foo)'/>", "argument 'foo' has no value; give foo:=VALUE"),
    ("<xacro:nothing/>", "unknown macro name: xacro:nothing"),
    ("<xacro:include filename='no.xacro'/>", "no such file or directory: "),
    ("<xacro:include filename='$(find nowhere)/a.xacro'/>", "no package 'nowhere'"),
    ("<xacro:if value='${1 +}'/>", "invalid syntax, when evaluating expression '1 +'"),
    ("<xacro:if value='maybe'/>", "not a boolean"),
    ("<link name='${1/0}'/>", "division by zero"),
    ("<link name='$(env SLIDECTL_NO_SUCH_VARIABLE)'/>", "SLIDECTL_NO_SUCH_VARIABLE"),
    ("<link name=\"${xacro.load_yaml('no.yaml')}\"/>", "no.yaml: no such file or directory"),
    ("<link name='${().__class__}'/>", "invalid name"),
    ("<xacro:macro name='m'><xacro:m/></xacro:macro><xacro:m/>", "call themselves without end"),
    ("<xacro:include filename='bot.xacro'/>", "call themselves without end"),
    ("<xacro:property name='a' value='${b}'/><xacro:property name='b' value='${a}'/><x y='${a}'/>", "circular"),
    ("<link", "not well-formed XML"),
    ("<link>&bang;</link>", "undefined entity"),
    ("<!DOCTYPE x [<!ENTITY a 'b'>]>", "not well-formed"),
]


@pytest.mark.parametrize(("text", "reason"), FAULTS)
def test_what_xacro_does_not_accept_is_named_with_file_and_line(write: Write, text: str, reason: str) -> None:
    path = write("bot.xacro", model("<link name='world'/>", text))
    with pytest.raises(BadFile) as caught:
        load(path)
    assert reason in str(caught.value)
    assert str(caught.value).startswith(f"{path}:")
    assert caught.value.line in (3, 4)


def test_an_included_file_that_is_too_large_is_refused(write: Write) -> None:
    os.truncate(write("large.xacro", ""), 40 * 2**30)  # a sparse file
    path = write("bot.xacro", model('<xacro:include filename="large.xacro"/>'))
    with pytest.raises(BadFile, match=r"large.xacro: is larger than 16 MiB"):
        load(path)


def test_a_fault_inside_a_macro_says_who_called_it(write: Write) -> None:
    macro = "<xacro:macro name='m' params='x'>\n<link name='${x / 0}'/>\n</xacro:macro>"
    path = write("bot.xacro", model(macro, "<xacro:m x='1'/>"))
    with pytest.raises(BadFile, match=r"bot.xacro:3: division by zero.*in macro 'm', called at .*bot.xacro:5"):
        load(path)


def test_a_broken_include_is_named_itself(write: Write) -> None:
    write("part.xacro", "<robot>\n<link></robot>")
    path = write("bot.xacro", model("<xacro:include filename='part.xacro'/>"))
    with pytest.raises(BadFile, match=r"part.xacro:2: not well-formed XML: mismatched tag"):
        load(path)


def test_an_optional_include_may_be_missing(write: Write) -> None:
    path = write("bot.xacro", model("<xacro:include filename='no.xacro' optional='true'/>", link("base")))
    assert parse(load(path).xml).root == "base"


def test_files_written_for_the_inorder_option_need_nothing_special(write: Write) -> None:
    order = "<xacro:property name='width' value='1'/><xacro:property name='width' value='${width * 2}'/>"
    path = write("bot.xacro", model(order, f"<link name='w${{width}}'>{INERTIAL}</link>"))
    with pytest.raises(BadFile, match="circular"):
        load(path)
    eager = order.replace("'${width * 2}'", "'${width * 2}' lazy_eval='false'")
    assert (
        parse(load(write("eager.xacro", model(eager, f"<link name='w${{width}}'>{INERTIAL}</link>"))).xml).root == "w2"
    )


def test_what_xacro_prints_and_warns_of_never_reaches_stdout(write: Write, capsys: pytest.CaptureFixture[str]) -> None:
    path = write("bot.xacro", model("<xacro:property name='pi' value='3'/>", "${xacro.message('hello')}", link("base")))
    document = load(path)
    assert capsys.readouterr().out == ""
    assert [notice.text for notice in document.report] == ["redefining global symbol: pi"]
    assert document.report[0].line == 2


def test_xacro_is_left_as_it_was_found(write: Write) -> None:
    functions = (xacro.parse, xacro.eval_all, xacro.warning, xacro.substitution_args._eval_find)
    load(write("good.xacro", model(link("base"))))
    with pytest.raises(BadFile):
        load(write("bad.xacro", model("<xacro:nothing/>")))
    assert functions == (xacro.parse, xacro.eval_all, xacro.warning, xacro.substitution_args._eval_find)
    assert sys.stdout is not sys.stderr


INSIDES = (
    *(getattr(xacro, name) for name in (
        "eval_all", "check_attrs", "handle_macro_call", "process_include", "parse", "warning", "error", "message",
        "print_location", "safe_eval", "load_yaml", "tokenize", "create_global_symbols", "init_stacks", "process_doc",
        "resolve_macro", "replace_node", "abs_filename_spec", "eval_text", "eval_extension", "XacroException",
        "NameSpace", "Table", "YamlDictWrapper", "YamlListWrapper", "ConstructUnits",
    )),
    substitution_args._eval, substitution_args._eval_find, substitution_args._find, substitution_args.resolve_args,
)  # fmt: skip


def test_the_insides_of_xacro_are_those_that_the_adapter_was_written_for() -> None:
    """After an update: read what has changed in them beside description/xacro_adapter.py, then take the new number."""
    assert zlib.crc32("".join(map(inspect.getsource, INSIDES)).encode()) == 581521012


def test_a_text_with_xacro_tags_is_expanded_without_a_file() -> None:
    bot = parse(load(model("<xacro:property name='n' value='base'/>", link("${n}"))).xml)
    assert bot.root == "base"
    assert bot.links["base"].file == "<text>"


def test_comments_stay_only_where_they_hide_a_text(write: Write) -> None:
    path = write("bot.xacro", model(link("base"), "<!-- a word -->", "<x><!-- hidden -->text</x>"))
    xml = load(path).xml
    assert "a word" not in xml
    assert "<x><!-- hidden -->text</x>" in xml


def test_tags_without_their_prefix_are_taken_as_until_kinetic_with_a_notice(write: Write) -> None:
    write(
        "parts.xacro",
        '<robot><property name="size" value="2"/><macro name="bar" params="name *place"><link name="${name}">'
        '<inertial><insert_block name="place"/><mass value="${size}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"'
        ' izz="1"/></inertial></link></macro></robot>',
    )
    path = write(
        "old.xacro",
        model(
            '<include filename="parts.xacro"/>',
            "<link name='world'/>",
            '<bar name="arm"><origin xyz="0 0 1"/></bar>',
            '<if value="0"><link name="never"/></if><unless value="0">' + joint(child="arm") + "</unless>",
            '<gazebo><plugin name="p" filename="f"><property name="kept" value="1"/></plugin></gazebo>',
        ),
    )
    document = load(path)
    assert [link.name for link in parse(document.xml).links.values()] == ["world", "arm"]
    assert '<property name="kept" value="1"' in document.xml
    assert [str(notice) for notice in document.report] == [
        f"{path}:2: xacro: <if>, <include>, <unless> without the prefix are read as <xacro:...>;"
        " xacro itself does so only until ROS Kinetic",
        f"{path.parent / 'parts.xacro'}:1: xacro: <insert_block>, <macro>, <property> without the prefix are read as"
        " <xacro:...>; xacro itself does so only until ROS Kinetic",
    ]
