"""Expressions of a xacro file: what xacro computes is computed alike, and what it says is reported."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from xml.dom import minidom
from xml.sax.saxutils import quoteattr

import pytest
import xacro

from slidectl.description import load

Write = Callable[[str, str], Path]

HEAD = '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">'
LIMITS = """
joints: {joint1: {limit: 1.5, mro: 2, gi_frame: 3, f_back: 4, format: 5, co_code: 6, items: 7}, list: [{a: 1}, 2]}
angle: !degrees 90
length: !millimeters 2 * 5
day: 2020-01-01
base: &base {a: 1}
more: {<<: *base, b: 2}
"""


def model(*values: str) -> str:
    """A robot with one tag that shows values, in line 3 and those after it."""
    shown = "\n".join(f"<x v={quoteattr(value)}/>" for value in values)
    return f'{HEAD}\n<xacro:property name="k" value="3"/>\n{shown}\n</robot>'


def by_xacro(path: Path) -> list[str]:
    """What xacro itself makes of a file."""
    document = minidom.parse(str(path))
    xacro.init_stacks(str(path))
    xacro.process_doc(document)
    return [node.getAttribute("v") for node in document.getElementsByTagName("x")]


def by_us(path: Path) -> list[str]:
    document = minidom.parseString(load(path).xml)
    return [node.getAttribute("v") for node in document.getElementsByTagName("x")]


@pytest.mark.parametrize(
    "expression",
    [
        "${1 + 2 * 3 - 4 / 2 // 1 % 3}",
        "${-k ** 2} ${k << 2} ${k ^ 1 | 8 & 12} ${~k} ${+k}",
        "${1 < k <= 3 and not k == 4 or 'never'}",
        "${'yes' if k in [1, 3] else 'no'} ${k is not None}",
        "${sin(pi / 2)} ${math.cos(math.pi)} ${radians(180)} ${hypot(3, 4)} ${atan2(1, 1)}",
        "${math.factorial(5)} ${comb(50, 2)} ${perm(5, 2)} ${perm(4)} ${prod([2, 3])} ${lcm(4, 6)} ${gcd(4, 6)}",
        "${isqrt(17)} ${math.prod([1.5, 2])} ${comb(1000, 500) % 1000}",
        "${round(2.567, 2)} ${round(1234, -2)} ${round(2.5)} ${round(k * 1.1)}",
        "${round(2.5678, ndigits=2)} ${(lambda v, lo=0, hi=1: max(lo, min(hi, v)))(5, hi=3)} ${(lambda v: v)(v=4)}",
        "${sorted(python.set([1, 2]).symmetric_difference([2, 3]))} ${python.set([1]).isdisjoint([2])}",
        "${'%0.3f' % pi} ${'%s-%02d' % ('a', k)} ${'%(a)s' % dict(a=1)} ${'%5.1f%%' % pi}",
        "${'a' + 'b' * 3} ${'abc'[1]} ${'abc'[::-1]} ${[1, 2, 3][-1]} ${(1, 2)[0]}",
        "${' '.join(['a', 'b'])} ${'a b'.split()[1]} ${' a '.strip()} ${'a_b'.replace('_', '/')} ${'x'.zfill(4)}",
        "${'JOINT'.lower().startswith('j')} ${'ab'.upper()} ${'a' in 'abc'} ${'l'.ljust(3) + 'r'.center(5) + '|'}",
        "${[x * 2 for x in [1, 2, 3] if x > 1]} ${sum([1, 2]) if False else ''}",
        "${[[x, y] for x, y in python.zip([1, 2], 'ab')]} ${dict([(x, x * x) for x in [1, 2]])}",
        "${(lambda x, y=2: x + y)(1)} ${list(map(lambda x: x * 2, [1, 2]))} ${list(map(str.upper, ['a']))}",
        "${dict(a=1, b=dict(c=2))} ${dict(dict(a=1), **dict(b=2))} ${dict(a=1)['a']} ${max(*[1, 5, 2])}",
        "${dict(a=1).get('b', 7)} ${list(dict(a=1, b=2).keys())} ${list(dict(a=1).items())[0][1]}",
        "${[1, *[2, 3]]} ${(1, *(2,))} ${len([1, 2])} ${min(1, 2)} ${max([3, 1], key=lambda x: -x)}",
        "${str(k) + '_link'} ${int('7') + float('1.5')} ${bool(0)} ${int('f', 16)} ${list('ab')}",
        "${python.sum([1, 2])} ${python.abs(-1)} ${python.any([0, 1])} ${python.all([])} ${python.divmod(7, 2)}",
        "${python.sorted([3, 1], reverse=True)} ${list(python.reversed([1, 2]))} ${python.ord('a')}",
        "${list(python.enumerate('ab', start=1))} ${list(python.filter(lambda x: x > 1, [1, 2]))} ${python.repr('a')}",
        "${python.isinstance(k, int)} ${python.type(k) == int} ${python.type('a') is str} ${python.complex(1, 2)}",
        "${[1, 2, 3][python.slice(0, 2)]} ${python.set([1, 1])} ${python.tuple([1])} ${[x for x in python.range(3)]}",
        "${xacro.tokenize('1 2,3;4')} ${xacro.tokenize('a|b', sep='|')} ${xacro.tokenize('a,,b', ',', False)}",
        "${xacro.dotify(dict(a=dict(b=1))).a.b} ${xacro.message('hello')}|${xacro.print_location()}",
        "${f'x' + 'y'} ${1_000} ${0x10} ${1e-3} ${.5} ${inf} ${'a' 'b'} ${u'c'} ${r'\\d'}",
        "$(eval 2**-1) $(eval 'a' + 'b') $(eval pi > 3) $(eval [1, 2][1]) $(eval true)",
    ],
)
def test_what_xacro_computes_is_computed_alike(write: Write, expression: str) -> None:
    path = write("bot.xacro", model(*expression.split("} $")) if "$(" in expression else model(expression))
    assert by_us(path) == by_xacro(path)


@pytest.mark.parametrize(
    "expression",
    [
        "${p.joints.joint1.limit} ${p['joints']['joint1']['limit'] + 1} ${p.joints['joint1'].limit}",
        "${p.joints.joint1.mro} ${p.joints.joint1.gi_frame} ${p.joints.joint1.f_back} ${p.joints.joint1.co_code}",
        "${p.joints.joint1.format + 1} ${p.joints.list[0].a} ${p.joints.list[1]} ${p.joints.list}",
        "${[j.a for j in p.joints.list[:1]]} ${'joint1' in p.joints} ${p.joints.get('j', 0)} ${p.more.a + p.more.b}",
        "${sorted(list(p.joints.keys()))} ${p.angle} ${p.length} ${p.day} ${len(p.joints.items())}",
        "${' '.join([str(v) for k, v in p.joints.joint1.items()])}",
    ],
)
def test_values_of_yaml_files_are_had_by_dots_with_any_key(write: Write, expression: str) -> None:
    write("limits.yaml", LIMITS)
    load_it = '<xacro:property name="p" value="${xacro.load_yaml(\'limits.yaml\')}"/>'
    path = write("bot.xacro", f"{HEAD}\n{load_it}\n<x v={quoteattr(expression)}/>\n</robot>")
    assert by_us(path) == by_xacro(path)


def test_properties_of_namespaces_and_functions_in_properties_are_kept(write: Write) -> None:
    write("part.xacro", f'{HEAD}<xacro:property name="parent" value="${{6 * 7}}"/></robot>')
    parts = [
        '<xacro:include filename="part.xacro" ns="part"/>',
        '<xacro:property name="double" value="${lambda x: x * factor}"/>',
        '<xacro:property name="factor" value="2"/>',
        '<x v="${part.parent} ${double(4)} ${[x * factor for x in [1]]}"/>',
    ]
    assert by_us(write("bot.xacro", f"{HEAD}{''.join(parts)}</robot>")) == ["42 8 [2]"]


def test_names_that_are_deprecated_still_work_and_are_reported(write: Write) -> None:
    document = load(write("bot.xacro", model("${sorted([2, 1])}")))
    assert 'v="[1, 2]"' in document.xml
    assert [str(notice.text) for notice in document.report] == [
        "Using sorted() directly is deprecated. Use python.sorted() instead."
    ]


def test_a_warning_of_the_file_is_a_notice_and_steers_no_terminal(
    write: Write, capsys: pytest.CaptureFixture[str]
) -> None:
    document = load(
        write("bot.xacro", model(r"${xacro.warning('a\x1b[2J\nb', 1)}${xacro.message('\x1b[0m')}${xacro.error('c')}"))
    )
    assert [(notice.text, notice.line) for notice in document.report] == [("a [2J b 1", 3), ("c", 3)]
    assert "\x1b" not in capsys.readouterr().err


def test_the_length_of_a_text_may_be_asked_for_by_its_name_in_python(write: Write) -> None:
    document = load(write("m.xacro", model("${'abc'.__len__()}", "${[1, 2].__len__()}")))
    assert 'v="3"' in document.xml
    assert 'v="2"' in document.xml
