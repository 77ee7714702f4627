"""Expressions of xacro files that mean harm: none runs code, and every one comes to an end with file and line."""

from __future__ import annotations

import os
import resource
from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import pytest
import yaml

from slidectl.description import load, xacro_adapter
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
    "int.from_bytes",
    "str.maketrans",
    "list.append.im_func",
    "math.pi.real",
    "math.os",
    "xacro.os.system" + RUN,
    "xacro.sys",
    "xacro.safe_eval('1', dict())",
    "xacro.parent.root",
    "python.root",
    "xacro.load_yaml.gi_frame",
    "xacro.load_yaml.__globals__",
    "(x := 1)",
    "[y := x for x in [1]]",
    "[x for x.a in [1]]",
    "fmt.format(1)",
    "'%s'.format.im_self",
    "named.format(a=1)",
    "indexed.format([1])",
    "nested.format(1, 2)",
    "str.format(fmt, 1)",
    "list(map(str.format, [fmt], [1]))",
    "fmt.format_map(dict(a=1))",
    "list(map(fmt.format, [1]))",
    "f'" + "x' + (1).__class__",
    "(1).\uff3f\uff3fclass\uff3f\uff3f",
    "(i for i in [1]).\uff47i_frame",
    "(1).real",
    "'a'.encode('zip')",
    "'a'.translate(dict())",
    "xacro.fatal('stop')",
    "xacro.fatal('stop').tb_frame",
    "(1 / 0).with_traceback",
    "True or ().__class__",
    "lambda *a: 1",
    "await x",
    "(yield)",
    "...",
    "b'a'",
    "1j",
    "print('a')",
    "input()",
    "breakpoint()",
    "help",
    "math.__loader__.load_module('os')",
    "__builtins__",
    "python.__builtins__",
    "python['__builtins__']",
]
FORMATS = (
    '<xacro:property name="fmt" value="{0.__class__}"/><xacro:property name="named" value="{a.real}"/>'
    '<xacro:property name="indexed" value="{0[0]}"/><xacro:property name="nested" value="{0:{1}}"/>'
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

ENDLESS = [
    ("round(7, -100000000)", "too many digits"),
    ("python.round(7, 10**9)", "too many digits"),
    ("factorial(3000000)", "too many factors"),
    ("math.factorial(501)", "too many factors"),
    ("comb(10**9, 10**8)", "too many factors"),
    ("perm(10**9, 10**8)", "too many factors"),
    ("perm(10**6)", "too many factors"),
    ("prod([2**4000] * 1000)", "too large"),
    ("prod(['a', 10**10])", "numbers only"),
    ("lcm(*[2**4000 - i for i in range(1000)])", "too large"),
    ("9**9**9", "is too large"),
    ("1 << 10**10", "too large"),
    ("2**4000 * 2**4000", "too large"),
    ("'a' * 10**11", "too long"),
    ("10**11 * [0]", "too long"),
    ("'a'.ljust(10**10)", "too long"),
    ("'a'.center(10**10)", "too long"),
    ("str.rjust('a', 10**10)", "too long"),
    ("'a'.zfill(10**10)", "too long"),
    ("('a' * 99999).replace('a', 'a' * 99999)", "too long"),
    ("('a' * 99999).join(['b'] * 9999)", "too long"),
    ("'%10000000000d' % 1", "too large"),
    ("'%.10000000000f' % 1", "too large"),
    ("'%*d' % (10**10, 1)", "too large"),
    ("'%(a)10000000000d' % dict(a=1)", "too large"),
    ("'%((a)b)10000000000d' % dict(a=1)", "too large"),
    ("wide.format(1)", "too large"),
    ("nested.format(1, 10**10)", "too large"),
    ("range(10**12)", "too long"),
    ("python.sum(range(10**12))", "too long"),
    ("list(python.range(10**11))[0]", "too long"),
    ("sorted(range(10**9))", "too long"),
    ("[x for x in range(1000) for y in range(1000)]", "steps"),
    ("[[0] * 99999 for x in range(999)]", "steps"),
    ("str(['a' * 99999 for x in range(999)])", "steps"),
    ("list(map(lambda x: list(range(9999)), range(9999)))", "steps"),
    ("(lambda f: f(f))(lambda f: f(f))", "without end"),
    ("(lambda l: list(map(l.append, l)) + [l.extend(l) for i in range(99)])([1])", "steps"),
    ("(lambda l: max(l, key=lambda x: l.append(1) or 0))([1])", "steps"),
    ("(lambda l: [l.append(l), str(l)])([1])", "steps"),
    ("(lambda d: d.update(d=[d, d]) or str(d))(dict())", "steps"),
    ("xacro.tokenize('a' * 30 + '!', 'x]|(a+)+$|[x')", "first of the letters"),
    ("1" + "+1" * 20000, "nested too deeply"),
    ("(" * 5000 + ")" * 5000, "nested"),
]


@pytest.mark.parametrize(("expression", "reason"), ENDLESS, ids=[expression[:40] for expression, _ in ENDLESS])
def test_an_expression_comes_to_an_end(write: Write, expression: str, reason: str) -> None:
    before = resource.getrlimit(resource.RLIMIT_AS)
    wide = '<xacro:property name="wide" value="{:10000000000}"/><xacro:property name="nested" value="{0:{1}}"/>'
    path = write("bot.xacro", f"{HEAD}\n{wide}\n<x v={quoteattr('${' + expression + '}')}/>\n</robot>")
    with pytest.raises(BadFile, match=reason) as caught:
        load(path)
    assert str(caught.value).startswith(f"{path}:3: ")
    assert resource.getrlimit(resource.RLIMIT_AS) == before


def test_texts_that_double_in_each_property_come_to_an_end(write: Write) -> None:
    doubling = "".join(f'<xacro:property name="a{n}" value="${{a{n - 1}}}${{a{n - 1}}}"/>' for n in range(1, 60))
    text = f'{HEAD}<xacro:property name="a0" value="much"/>{doubling}<x v="${{a59}}"/></robot>'
    with pytest.raises(BadFile, match="too long"):
        load(write("bot.xacro", text))


def test_macros_that_make_much_of_little_are_out_of_memory(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(xacro_adapter, "MOST_MEMORY", 1 << 26)
    large = f'<y z="{"x" * 1_000_000}${{1}}"/>'
    insert = '<xacro:insert_block name="b{0}"/>'
    blocks = "".join(f'<xacro:property name="b{n}">{insert.format(n - 1) * 2}</xacro:property>' for n in range(1, 40))
    text = f'{HEAD}<xacro:property name="b0">{large}</xacro:property>{blocks}{insert.format(39)}</robot>'
    with pytest.raises(BadFile, match=r"it takes more than .* of memory"):
        load(write("bot.xacro", text))


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (
            "a0: &a0 [1]\n" + "".join(f"a{n}: &a{n} [*a{n - 1}, *a{n - 1}]\n" for n in range(1, 60)),
            "what aliases repeat",
        ),
        (
            "a0: &a0 {k: 1}\n" + "".join(f"a{n}: &a{n} {{<<: [*a{n - 1}, *a{n - 1}]}}\n" for n in range(1, 60)),
            "aliases",
        ),
        ("a: &a [*a]", "what aliases repeat"),
        ("a: " + "1:" * 100000 + "1", "digits"),
        ("a: " + "1" * 5000, "digits"),
        ("[" * 2000, "nested"),
        ("a: [1", "not YAML"),
        ("a: !degrees 9**9**9", "too large"),
        ("a: !degrees x", "name 'x' is not defined"),
    ],
    ids=["aliases", "merges", "itself", "sixties", "digits", "depth", "syntax", "power", "name"],
)
def test_a_yaml_file_comes_to_an_end(write: Write, text: str, reason: str) -> None:
    write("v.yaml", text)
    with pytest.raises(BadFile, match=reason):
        load(write("bot.xacro", loading("v.yaml")))


def test_a_yaml_file_that_is_too_large_is_refused(write: Write) -> None:
    os.truncate(write("large.yaml", ""), 40 * 2**30)  # a sparse file
    with pytest.raises(BadFile, match=r"large.yaml: is larger than 2 MiB"):
        load(write("bot.xacro", loading("large.yaml")))
