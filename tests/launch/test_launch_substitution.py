"""`$(...)` in attributes: what each gives, how it combines with others, and what is refused."""

from __future__ import annotations

import re
from typing import Any

import pytest
from launch_files import Workspace, notices

from slidectl.confined import Limits
from slidectl.errors import BadFile
from slidectl.extensions.launch import substitution
from slidectl.extensions.launch.substitution import EvalError, evaluate

MEMORY = "takes more than 64 MiB of memory"
TIME = "takes more than 1 s"


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("plain", "plain"),
        ("$(arg a)", "one"),
        ("$(arg a)-$(arg a)/$(arg b)", "one-one/2"),
        ("$(arg b)", 2),
        ("$(arg b).0", 2.0),
        ("  $(arg   a)  ", "one"),
        ("$ (arg a) $a $$", "$ (arg a) $a $$"),
        ("$(optenv NOT_SET)", ""),
        ("$(optenv NOT_SET a  b)", "a b"),
        ("$(optenv HERE other)", "home"),
        ("$(env HERE)!", "home!"),
        ("$(arg c)", "$(arg a)"),
    ],
)
def test_each_is_put_in_where_it_stands(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch, text: str, expected: Any
) -> None:
    monkeypatch.setenv("HERE", "home")
    found = workspace.value(text, a="one", b="2", c="$(arg a)")
    assert found == expected
    assert type(found) is type(expected)


def test_packages_and_the_files_own_folder_are_found(workspace: Workspace) -> None:
    assert workspace.value("$(find demo)/urdf/x.xacro") == f"{workspace.package}/urdf/x.xacro"
    assert workspace.value("$(dirname)") == str(workspace.package / "launch")


@pytest.mark.parametrize(
    ("written", "meant"),
    [
        ("", "{}"), ("/", "{}"), ("/a b", "{}/a b"), (" /a", "{} /a"), ("a", "{}/a"), (":a", "{}/:a"),
        ("../a", "{}/../a"),
        ("/a//b/", "{}/a//b/"), ("//a", "/a"), ("\\a\\b", "{}/a/b"), ("$(arg x)", "{}/1"), ("/$(arg x)/c", "{}/1/c"),
    ],
)  # fmt: skip
def test_a_packages_folder_is_joined_with_the_path_after_it(workspace: Workspace, written: str, meant: str) -> None:
    assert workspace.value(f"p=$(find demo){written}", x="1") == "p=" + meant.format(workspace.package)


def test_an_included_file_has_its_own_folder_and_its_own_neighbours(workspace: Workspace) -> None:
    neighbour = workspace.folder / "elsewhere" / "neighbour"
    neighbour.mkdir(parents=True)
    (neighbour / "package.xml").write_text("<package><name>neighbour</name></package>")
    other = workspace.folder / "elsewhere" / "other"
    other.mkdir()
    (other / "a.launch").write_text(
        '<launch><param name="d" value="$(dirname)"/><param name="n" value="$(find neighbour)"/>'
        '<param name="own" value="$(find demo)"/></launch>'
    )
    found = workspace.values(f'<include file="{other}/a.launch"/>')
    assert found == {"/d": str(other), "/n": str(neighbour), "/own": str(workspace.package)}


def test_a_file_of_a_package_in_source_is_found_where_it_would_be_installed(workspace: Workspace) -> None:
    (workspace.package / "CMakeLists.txt").write_text("install(DIRECTORY description/urdf DESTINATION share/demo)")
    source = workspace.package / "description" / "urdf" / "one.xacro"
    source.parent.mkdir(parents=True)
    source.write_text("")
    assert workspace.value("$(find demo)/urdf/$(arg file)", file="one.xacro") == str(source)
    assert workspace.value("'$(find-pkg-share demo)/urdf/$(arg file)'", file="one.xacro") == f"'{source}'"
    assert workspace.value("$(find demo)/urdf/two.xacro") == f"{workspace.package}/urdf/two.xacro"


def test_find_is_understood_in_what_another_substitution_gives_and_nothing_else_is(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MODEL", "$(find demo)/m.urdf")
    assert workspace.value("$(arg model)", model="$(find demo)/urdf/m.urdf") == f"{workspace.package}/urdf/m.urdf"
    assert workspace.value("$(env MODEL)") == f"{workspace.package}/m.urdf"
    assert workspace.value("$(find demo)/$(arg a)", a="/abs") == "/abs"
    assert workspace.value("$(arg a)", a="$(dirname)") == "$(dirname)"
    assert workspace.value("$(eval a)", a="$(find demo)") == "$(find demo)"
    with pytest.raises(BadFile, match="unknown substitution"):
        workspace.value("$(arg a)", a="$(foo)")


def test_anon_gives_one_name_for_one_identifier_and_different_ones_for_others(workspace: Workspace) -> None:
    plan = workspace.plan(
        '<node pkg="rviz" type="rviz" name="$(anon view)"/><node pkg="rviz" type="rviz" name="$(anon other)"/>'
        '<param name="x" value="$(anon view)"/>'
    )
    first, second = (node.name for node in plan.nodes)
    assert first.startswith("view_")
    assert second.startswith("other_")
    assert plan.parameters()["/x"][0] == first
    again = workspace.node('<node pkg="rviz" type="rviz" name="$(anon view)"/>')
    assert again.name != first


def test_each_include_has_anonymous_names_of_its_own(workspace: Workspace) -> None:
    workspace.launch_file('<node pkg="rviz" type="rviz" name="$(anon view)"/>', "inner.launch")
    plan = workspace.plan('<include file="$(dirname)/inner.launch"/><include file="$(dirname)/inner.launch"/>')
    assert len({node.name for node in plan.nodes}) == 2


@pytest.mark.parametrize(
    ("expression", "expected"),
    [
        ("1 + 1", 2),
        ("a + '_' + str(b)", "one_2"),
        ("arg('b') * 2.5", 5.0),
        ("b > 1 and a == 'one'", True),
        ("not true", False),
        ("'yes' if on else 'no'", "yes"),
        ("sin(pi / 2)", 1.0),
        ("env('HERE') + optenv('NOT_SET', '!')", "home!"),
        ("max", None),
        ("'/'.join(['a', 'b'])", "a/b"),
        ("[x * 2 for x in [1, 2, 3] if x > 1][0]", 4),
        ("dict([['k', 'v']])['k']", "v"),
        ("'%s-%02d' % (a, b)", "one-02"),
        ("a.startswith('o')", True),
        ("list(map(int, '1 2'.split()))[1]", 2),
        ("1e3", 1000.0),
        ("'010'", 10),
        ("a[0:2]", "on"),
        ("len(a) + max(1, b) + abs(-1) + round(2.5) + int('f', base=16)", 23),
        ("'{}-{:02d}'.format(a, b)", "one-02"),
        ("f'{a!r}{b:.1f}'", "'one'2.0"),
        ("sorted([3, b, 1], reverse=True)[0]", 3),
        ("dict(k=1)['k'] << 3", 8),
        ("sum([x * y for x, y in zip(range(3), [4, 5, 6])])", 17),
        ("{x: 1 for x in 'ab'}['b']", 1),
        ("a.zfill(5)", "00one"),
        ("max(*[1, b], **{})", 2),
        ("(lambda x, y=1: x + y)(b)", 3),
        ("list(map(str.upper, [a]))[0]", "ONE"),
        ("'{x}-{0!r}'.format(a, x=b)", "2-'one'"),
        ("comb(5, 2) + factorial(3) + perm(3, 2)", 22),
    ],
)
def test_eval_computes_and_the_result_is_typed_again(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch, expression: str, expected: Any
) -> None:
    monkeypatch.setenv("HERE", "home")
    if expected is None:
        with pytest.raises(BadFile, match="gives a function"):
            workspace.value(f"$(eval {expression})", a="one", b="2", on="true")
        return
    found = workspace.value(f"$(eval {expression})", a="one", b="2", on="true")
    assert found == expected
    assert type(found) is type(expected)


def test_an_arg_goes_before_a_function_of_its_name_but_not_before_a_constant(workspace: Workspace) -> None:
    assert workspace.value("$(eval max + 1)", max="5") == 6
    assert workspace.value("$(eval pi < 4)", pi="5") is True


def test_eval_finds_packages_and_folders_too(workspace: Workspace) -> None:
    assert workspace.value("$(eval find('demo') + '/x')") == f"{workspace.package}/x"
    assert workspace.value("$(eval dirname())") == str(workspace.package / "launch")
    with pytest.raises(BadFile, match="no package 'nope'"):
        workspace.value("$(eval find('nope'))")
    with pytest.raises(BadFile, match="there is no argument 'nope' here"):
        workspace.value("$(eval arg('nope'))")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("expression", "reason"),
    [
        ("().__class__", "double underscores"),
        ("open('/etc/passwd')", "there is no name 'open'"),
        ("eval('1')", "there is no name 'eval'"),
        ("[i.__class__ for i in [1]]", "double underscores"),
        ("'{0.real}'.format(1)", "is not the number or the name of a value"),
        ("(i for i in [1]).gi_frame", "uses 'gi_frame', which expressions here do not have"),
        ("str.mro()", "uses 'mro', which"),
        ("map(str.format, ['{0.real}'], [1]).__next__()", "double underscores"),
        ("list(map(str.format, ['{0.real}'], [1]))", "is not the number or the name of a value"),
        ("'{:999999999}'.format(1)", MEMORY),
        ("'{:{}}'.format(1, 999999999)", MEMORY),
        ("f'{1:{10 ** 9}}'", MEMORY),
        ("'a'.zfill(10 ** 9)", MEMORY),
        ("list(range(10 ** 9))", MEMORY),
        ("1 << 10 ** 11", f"{MEMORY}|too many digits"),
        ("round(1, -(10 ** 9))", TIME),
        ("factorial(3000000)", TIME),
        ("comb(10 ** 9, 10 ** 8)", TIME),
        ("sum(range(10 ** 12))", TIME),
        ("'%(a)10000000000d' % {'a': 1}", MEMORY),
        ("str(['a' * 99999 for x in range(99999)])", MEMORY),
        ("(lambda a: list(map(a.append, a)) + [a.extend(a) for i in range(99)])([1])", f"{MEMORY}|{TIME}"),
        ("x := 1", "not valid"),
        ("9 ** 9 ** 9", TIME),
        ("'a' * 10 ** 9", MEMORY),
        ("'%999999999d' % 1", MEMORY),
        ("''.join(['a' * 99999] * 99999)", MEMORY),
        ("'a' * 5000000", "its result exceeds 4 MiB"),
        ("1 / 0", "cannot be computed: division by zero"),
        ("unknown", "there is no name 'unknown'"),
        ("1()", "is not callable"),
        ("(" * 1500 + ")" * 1500, "valid"),
        ("1 + " * 20000 + "1", "cannot be computed|not valid"),
    ],
)
def test_eval_refuses_what_could_do_harm_or_never_ends(
    monkeypatch: pytest.MonkeyPatch, expression: str, reason: str
) -> None:
    monkeypatch.setattr(substitution, "LIMITS", Limits(cpu_s=1, wall_s=60, new_bytes=1 << 26))
    with pytest.raises(EvalError, match=reason):
        evaluate(expression, {"a": "one"})


@pytest.mark.slow
def test_lists_that_double_in_each_turn_come_to_an_end(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(substitution, "LIMITS", Limits(cpu_s=1, wall_s=60, new_bytes=1 << 26))
    doubling = "[[1, 1]] " + " ".join(f"for v{k} in [[v{k - 1}, v{k - 1}]]" for k in range(1, 60))
    with pytest.raises(EvalError, match=f"{MEMORY}|{TIME}"):
        evaluate(f"str([v59 for v0 in {doubling}])", {})


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("$(find $(arg a))", "one substitution is inside a substitution"),
        ("$(arg a", r"'\$\(' is not closed"),
        ("$()", "unknown substitution"),
        ("$(arg)", r"\$\(arg\) takes exactly one name, not 0"),
        ("$(arg a b)", r"\$\(arg\) takes exactly one name, not 2"),
        ("$(env)", r"\$\(env\) takes exactly one name"),
        ("$(optenv)", "needs the name of a variable"),
        ("$(dirname x)", "takes nothing after it"),
        ("$(optenv NOT_SET (x))", "a bracket is inside a substitution"),
        ("$(fnd demo)", "Did you mean 'find'?"),
        ("$(arg aa)", "Did you mean 'a'?"),
        ("x $(eval 1)", "must be the whole value"),
    ],
)
def test_what_makes_no_sense_is_refused_with_the_attribute(workspace: Workspace, text: str, reason: str) -> None:
    with pytest.raises(BadFile, match=rf"test.launch:1: <param>: value: .*{reason}"):
        workspace.value(text, a="x")


def test_arguments_win_over_nothing_that_roslaunch_has_names_for(workspace: Workspace) -> None:
    assert workspace.value("$(eval e)", e="7") == pytest.approx(2.718281828459045)
    assert workspace.value("$(eval arg('e'))", e="7") == 7


def test_inline_yaml_is_substituted_only_when_it_asks_for_it(workspace: Workspace) -> None:
    content = '<arg name="a" value="5"/><rosparam subst_value="{}">x: $(arg a)</rosparam>'
    assert workspace.values(content.format("true")) == {"/x": 5}
    assert workspace.values(content.format("false")) == {"/x": "$(arg a)"}
    workspace.write("p.yaml", "y: [$(arg a), $(eval 1+1)]")
    with pytest.raises(BadFile, match=re.escape("$(eval) must be the whole value")):
        workspace.values('<arg name="a" value="5"/><rosparam subst_value="true" file="$(find demo)/p.yaml"/>')
    workspace.write("p.yaml", "y: [$(arg a), $(dirname)]")
    found = workspace.values('<arg name="a" value="5"/><rosparam subst_value="true" file="$(find demo)/p.yaml"/>')
    assert found == {"/y": [5, str(workspace.package / "launch")]}


def test_an_argument_that_is_declared_later_is_not_known_earlier(workspace: Workspace) -> None:
    with pytest.raises(BadFile, match="there is no argument 'late' here"):
        workspace.plan('<param name="x" value="$(arg late)"/><arg name="late" value="1"/>')
    plan = workspace.plan('<rosparam subst_value="true">x: $(arg a)</rosparam><arg name="a" value="1"/>')
    with pytest.raises(BadFile, match="there is no argument 'a' here"):
        plan.parameters()
    assert notices(plan) == []


@pytest.mark.parametrize("call", ["arg(5)", "arg(a)", "find(1.5)", "env(true)", "optenv(3)", "anon([])"])
def test_a_function_of_an_expression_wants_names_in_quotes(workspace: Workspace, call: str) -> None:
    with pytest.raises(BadFile, match=r"takes names, in quotes, and not "):
        workspace.value(f"$(eval {call})", a="5")


def test_the_default_of_optenv_in_an_expression_may_be_a_number(workspace: Workspace) -> None:
    assert workspace.value("$(eval int(optenv('NO_SUCH_VARIABLE', 0)) + 1)") == 1


def test_the_distribution_is_noetic_where_no_other_is_set(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("ROS_DISTRO", raising=False)
    assert workspace.value("$(env ROS_DISTRO)") == "noetic"
    monkeypatch.setenv("ROS_DISTRO", "melodic")
    assert workspace.value("$(env ROS_DISTRO)") == "melodic"


def test_joint_state_controllers_file_is_where_it_stood_before_noetic(workspace: Workspace) -> None:
    file = "$(find joint_state_controller)/joint_state_controller.yaml"
    found = workspace.values(f'<rosparam file="{file}"/>')
    assert found["/joint_state_controller/type"] == "joint_state_controller/JointStateController"
