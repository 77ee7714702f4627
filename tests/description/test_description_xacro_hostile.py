"""Expressions of xacro files that mean harm: none runs code, and every one comes to an end with file and line."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.dom import minidom
from xml.sax.saxutils import quoteattr

import pytest
import yaml

from slidectl.description import load, xacro_adapter
from slidectl.description.xacro_adapter import LIMITS
from slidectl.errors import BadFile

Write = Callable[[str, str], Path]

HEAD = '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">'

# --- what runs code ---------------------------------------------------------------------------------------------------

RUN = "('touch pwned')"
SUBCLASSES = "().__class__.__base__.__subclasses__()"
ESCAPES = [
    SUBCLASSES,
    f"[[c for c in {SUBCLASSES} if c.__name__ == '_wrap_close'][0].__init__.__globals__['system']{RUN} for i in [0]]",
    f"(lambda: {SUBCLASSES})()",
    f"[x for x in (lambda: [y for y in {SUBCLASSES}])()]",
    "(i for i in [1]).gi_frame.f_back.f_builtins['open']('pwned', 'w')",
    "[g.gi_frame for g in [(i for i in [1])]]",
    "(i for i in [1]).gi_code.co_consts",
    "(lambda: 1).func_globals",
    "(lambda: 1).__globals__",
    "(lambda __class__: 1)(1)",
    "dict(__class__=1)",
    "__import__('os').system" + RUN,
    "[__import__('os') for i in [0]]",
    "open('pwned', 'w')",
    "eval('1')",
    "exec('1')",
    "compile('1', '', 'eval')",
    "getattr(1, '__cla' + 'ss__')",
    "python.getattr(1, 'real')",
    "setattr(xacro, 'a', 1)",
    "globals()",
    "locals()",
    "vars()",
    "python.vars()",
    "python.vars(str)",
    "type(1)",
    "python.type(len)",
    "python.type(python.type(1))",
    "python.type('X', (), dict(a=1))",
    "python.type(lambda: 1)",
    "str.mro()",
    "str.format('a').mro",
    "int.mro()[1]",
    "list.append.im_func",
    "math.os",
    "xacro.os.system" + RUN,
    "xacro.sys",
    "xacro.safe_eval('1', dict())",
    "xacro.parent.root",
    "python.root",
    "xacro.load_yaml.gi_frame",
    "xacro.load_yaml.__globals__",
    "[x for x.a in [1]]",
    "fmt.format(1)",
    "'%s'.format.im_self",
    "named.format(a=1)",
    "indexed.format([1])",
    "str.format(fmt, 1)",
    "list(map(str.format, [fmt], [1]))",
    "fmt.format_map(dict(a=1))",
    "list(map(fmt.format, [1]))",
    "f'" + "x' + (1).__class__",
    "(1).\uff3f\uff3fclass\uff3f\uff3f",
    "(i for i in [1]).\uff47i_frame",
    "'a'.encode('zip')",
    "xacro.fatal('stop')",
    "xacro.fatal('stop').tb_frame",
    "(1 / 0).with_traceback",
    "True or ().__class__",
    "await x",
    "(yield)",
    "print('a')",
    "input()",
    "breakpoint()",
    "help",
    "math.__loader__.load_module('os')",
    "__builtins__",
    "python.__builtins__",
    "python['__builtins__']",
    "part.parent.gi_frame",
    "part.root",
    "part['root'].root",
    "'{0.__globals__[sys].modules[ctypes].cdll[./pwned.so]}'.format(xacro.fatal)",
    "'{:{0.__class__}}'.format(1)",
    "list(map('{0.__class__}'.format, [1]))",
    "str.format('{0.__class__}', 1)",
    "f'{xacro.fatal.__globals__}'",
    "f'{(i for i in [1]).gi_frame}'",
    "python.vars(python.type(xacro.fatal))['__globals__']",
    "(lambda: (yield))().gi_frame",
    "(i for i in [1]).throw(1).tb_frame",
    "[a for a in [().__class__]]",
    "{().__class__: 1 for i in [1]}",
    "(lambda a=().__class__: a)()",
    "int.__len__.__objclass__",
]
HARMLESS = {
    "int.from_bytes": "from_bytes of type object", "(x := 1)": "1", "[y := x for x in [1]]": "[1]",
    "math.pi.real": "3.14", "str.maketrans": "maketrans",
    "nested.format(1, 2)": " 1", "(1).real": "1", "...": "Ellipsis",
    "(lambda *a: a)(1)": "(1,)", "b'a'": "b'a'", "'a'.translate(dict())": "a", "1j": "1j",
    "list(map(padded.format, [1]))": "  1", "str.format(padded, 'b')": "  b", "python.type('a')('b')": "b",
}  # fmt: skip
"""Expressions that compute values, and what is in the text of the result: xacro has them, so they are no attack."""
FORMATS = (
    '<xacro:property name="fmt" value="{0.__class__}"/><xacro:property name="named" value="{a.real}"/>'
    '<xacro:property name="indexed" value="{0[0]}"/><xacro:property name="nested" value="{0:{1}}"/>'
    '<xacro:property name="padded" value="{:>3}"/>'
)


def loading(file: str) -> str:
    """A model that loads a YAML file."""
    return f"{HEAD}<x v=\"${{xacro.load_yaml('{file}')}}\"/></robot>"


def refused(write: Write, text: str) -> BadFile:
    """The error of a model with such an attribute in its fourth line."""
    path = write("bot.xacro", f"{HEAD}\n{FORMATS}\n<a/>\n<x v={quoteattr(text)}/>\n</robot>")
    with pytest.raises(BadFile) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}:4: ")
    assert "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize(
    ("form", "expression"),
    [
        *(("${%s}", expression) for expression in ESCAPES),
        *(("${[%s for i in [0]]}", expression) for expression in ESCAPES[::4]),
        *(("$(eval %s)", expression) for expression in ESCAPES[::4]),
    ],
)
def test_an_expression_runs_no_code(
    write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, expression: str, form: str
) -> None:
    monkeypatch.chdir(tmp_path)
    refused(write, form % expression)
    assert os.listdir(tmp_path) == ["bot.xacro"]


@pytest.mark.parametrize("expression", HARMLESS)
def test_an_expression_that_only_computes_is_computed_and_writes_nothing(
    write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, expression: str
) -> None:
    monkeypatch.chdir(tmp_path)
    text = f"{HEAD}{FORMATS}<x v={quoteattr('${' + expression + '}')}/></robot>"
    (shown,) = minidom.parseString(load(write("bot.xacro", text)).xml).getElementsByTagName("x")
    assert HARMLESS[expression] in shown.getAttribute("v")
    assert os.listdir(tmp_path) == ["bot.xacro"]


def test_a_yaml_file_runs_no_code_and_its_units_are_gone_afterwards(
    write: Write, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    before = dict(yaml.SafeLoader.yaml_constructors)
    monkeypatch.chdir(tmp_path)
    for text in (f"!degrees {SUBCLASSES}", "!degrees open('pwned', 'w')", "!!python/object/apply:os.system [id]"):
        write("v.yaml", text)
        with pytest.raises(BadFile):
            load(write("bot.xacro", loading("v.yaml")))
    assert sorted(os.listdir(tmp_path)) == ["bot.xacro", "v.yaml"]
    assert yaml.SafeLoader.yaml_constructors == before


# --- what never ends --------------------------------------------------------------------------------------------------

TIME = "takes more than 1 s"
MEMORY = "it takes more than 64 MiB of memory"
ENDLESS = [
    ("round(7, -100000000)", TIME),
    ("factorial(3000000)", TIME),
    ("comb(10**9, 10**8)", TIME),
    ("perm(10**9, 10**8)", TIME),
    ("perm(10**6)", TIME),
    ("prod([2**4000] * 1000)", "limit .4300 digits."),
    ("prod(['a', 10**10])", MEMORY),
    ("lcm(*[2**4000 - i for i in range(1000)])", TIME),
    ("9**9**9", TIME),
    ("1 << 10**10", MEMORY),
    ("'a' * 10**11", MEMORY),
    ("10**11 * [0]", MEMORY),
    ("'a'.ljust(10**10)", MEMORY),
    ("'a'.center(10**10)", MEMORY),
    ("str.rjust('a', 10**10)", MEMORY),
    ("'a'.zfill(10**10)", MEMORY),
    ("('a' * 99999).replace('a', 'a' * 99999)", MEMORY),
    ("('a' * 99999).join(['b'] * 9999)", MEMORY),
    ("'%10000000000d' % 1", MEMORY),
    ("'%.10000000000f' % 1", "precision too big"),
    ("'%*d' % (10**10, 1)", MEMORY),
    ("'%(a)10000000000d' % dict(a=1)", MEMORY),
    ("wide.format(1)", MEMORY),
    ("nested.format(1, 10**10)", MEMORY),
    ("list(python.range(10**11))[0]", MEMORY),
    ("sorted(range(10**9))", MEMORY),
    ("[[0] * 99999 for x in range(999)]", f"{MEMORY}|{TIME}"),
    ("str(['a' * 99999 for x in range(999)])", f"{MEMORY}|{TIME}"),
    ("list(map(lambda x: list(range(9999)), range(9999)))", f"{MEMORY}|{TIME}"),
    ("(lambda f: f(f))(lambda f: f(f))", "without end"),
    ("(lambda l: list(map(l.append, l)) + [l.extend(l) for i in range(99)])([1])", f"{MEMORY}|{TIME}"),
    ("(lambda l: max(l, key=lambda x: l.append(1) or 0))([1])", f"{MEMORY}|{TIME}"),
    ("xacro.tokenize('a' * 30 + '!', 'x]|(a+)+$|[x')", TIME),
    ("1" + "+1" * 20000, "without end"),
    ("(" * 5000 + ")" * 5000, "nested"),
]


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Small limits of a run."""
    monkeypatch.setattr(xacro_adapter, "LIMITS", replace(LIMITS, cpu_s=1, new_bytes=1 << 26))


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(("expression", "reason"), ENDLESS, ids=[expression[:40] for expression, _ in ENDLESS])
def test_an_expression_comes_to_an_end(write: Write, expression: str, reason: str) -> None:
    wide = '<xacro:property name="wide" value="{:10000000000}"/><xacro:property name="nested" value="{0:{1}}"/>'
    path = write("bot.xacro", f"{HEAD}\n{wide}\n<x v={quoteattr('${' + expression + '}')}/>\n</robot>")
    with pytest.raises(BadFile, match=reason) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}:3: ")


@pytest.mark.usefixtures("small")
def test_a_library_that_does_not_come_back_is_ended_with_the_file_and_the_limit(write: Write) -> None:
    path = write("bot.xacro", f'{HEAD}\n<x v="${{python.sum(range(10**12))}}"/></robot>')
    with pytest.raises(BadFile) as caught:
        load(path)
    assert str(caught.value) == f"{path}: cannot expand it: it takes more than 1 s"


@pytest.mark.usefixtures("small")
def test_texts_that_double_in_each_property_come_to_an_end(write: Write) -> None:
    doubling = "".join(f'<xacro:property name="a{n}" value="${{a{n - 1}}}${{a{n - 1}}}"/>' for n in range(1, 60))
    text = f'{HEAD}<xacro:property name="a0" value="much"/>{doubling}<x v="${{a59}}"/></robot>'
    with pytest.raises(BadFile, match=MEMORY):
        load(write("bot.xacro", text))


@pytest.mark.usefixtures("small")
def test_macros_that_make_much_of_little_are_out_of_memory(write: Write) -> None:
    large = f'<y z="{"x" * 1_000_000}${{1}}"/>'
    insert = '<xacro:insert_block name="b{0}"/>'
    blocks = "".join(f'<xacro:property name="b{n}">{insert.format(n - 1) * 2}</xacro:property>' for n in range(1, 40))
    text = f'{HEAD}<xacro:property name="b0">{large}</xacro:property>{blocks}{insert.format(39)}</robot>'
    with pytest.raises(BadFile, match=MEMORY):
        load(write("bot.xacro", text))


@pytest.mark.usefixtures("small")
@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "a0: &a0 [1]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 60)),
            f"{MEMORY}|{TIME}",
        ),
        ("a: " + "1:" * 100000 + "1", f"digits|{TIME}"),
        ("a: " + "1" * 5000, "digits"),
        ("[" * 2000, f"without end|{TIME}"),
        ("a: [1", r"not YAML: .*v.yaml., line 1"),
        ("a: !degrees 9**9**9", TIME),
        ("a: !degrees x", "name 'x' is not defined"),
    ],
    ids=["aliases", "sixties", "digits", "depth", "syntax", "power", "name"],
)
def test_a_yaml_file_comes_to_an_end(write: Write, text: str, reason: str) -> None:
    write("v.yaml", text)
    with pytest.raises(BadFile, match=reason):
        load(write("bot.xacro", loading("v.yaml")))


def test_a_yaml_file_that_is_too_large_is_refused(write: Write) -> None:
    os.truncate(write("large.yaml", ""), 40 * 2**30)  # a sparse file
    with pytest.raises(BadFile, match=r"large.yaml: is larger than 2 MiB"):
        load(write("bot.xacro", loading("large.yaml")))
