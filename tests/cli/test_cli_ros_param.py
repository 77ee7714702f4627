"""`rosparam` in recorded sessions of the real tool, in the order in which they were recorded."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from cli_ros_world import Session, Shell, usage
from command_line import CommandLine
from daemon_fixture import running_daemon

FILES = {
    "one.yaml": "data: 3.25\n",
    "p.yaml": "controller:\n  type: position_controllers/JointPositionController\n  joint: slide\n"
    "  pid: {p: 100.0, i: 0.01, d: 10.0}\n  limits: [-0.5, 0.5]\n  offset: deg(45)\n",
    "p2.yaml": "a: 1\n---\nb: 2\n",
    "pns.yaml": "_ns: inner\na: 1\n",
    "pscalar.yaml": "3\n",
    "plist.yaml": "- 1\n- 2\n",
    "pempty.yaml": "",
    "pbad.yaml": "a: [1\n",
    "pdup.yaml": "a: 1\na: 2\n",
    "psub.yaml": "a: $(env HOME)\n",
}
SLIDE = """controller:
  joint: slide
  limits:
  - -0.5
  - 0.5
  offset: 0.7853981633974483
  pid:
    d: 10.0
    i: 0.01
    p: 100.0
  type: position_controllers/JointPositionController
"""
LINES = """NS/controller/type=position_controllers/JointPositionController
NS/controller/joint=slide
NS/controller/pid/p=100.0
NS/controller/pid/i=0.01
NS/controller/pid/d=10.0
NS/controller/limits=[-0.5, 0.5]
NS/controller/offset=0.7853981633974483
"""
SET, GET, DELETE = (
    "rosparam set [options] parameter value",
    "rosparam get [options] parameter",
    "rosparam delete [options] parameter",
)
NO_NAME = "invalid arguments. Please specify a parameter name"
MANY = "too many arguments"

ILLEGAL = (
    "ERROR: '{}' is not a legal name of a parameter: parts without blanks, with a '/' between and no '~' in front\n"
)
GREEN = 'grün ☃\n"gr\\xFCn \\u2603"\n\n'

TAGS = "a: 3.141592653589793\nb:\n- 1.5707963267948966\n\n"
PRETTY = "{deep: {list: [1, two], empty: ''}, flag: true, small: 1.0e-7, text: 'q\n\nr\n\n'}"
# Its lists and texts of several lines are for eyes: this is no YAML.
PRETTY_LINES = "deep:\n  empty: \n  list: - 1\n- two\nflag: true\nsmall: 1.0e-07\ntext: |\n  q\n  r\n  \n"

# They build on each other.
SESSIONS = [
    usage("rosparam set", SET, NO_NAME),
    usage("rosparam set /a", SET, "invalid arguments. Please specify a parameter value"),
    Session("rosparam set /a 1"),
    Session("rosparam set /f 1.5"),
    Session("rosparam set /neg -5"),
    Session("rosparam set /neg -0.5"),
    Session("rosparam set /s hello"),
    Session("rosparam set /s2 'two words'"),
    Session("rosparam set /e ''"),
    Session("rosparam set /b true"),
    Session("rosparam set /num_as_str '\"1\"'"),
    Session("rosparam set /l '[1, 2.0, x]'"),
    Session("rosparam set /d '{p: 1.0, i: 0.1, nested: {x: 2}}'"),
    Session("rosparam set /d '{d: 0.01}'"),
    usage("rosparam set /a 1 2", SET, MANY),
    Session("rosparam set -v /v 1", "set parameter [/v] to [1]\n"),
    Session('rosparam set /deg "deg(90)"'),
    Session('rosparam set /rad "rad(pi/2)"'),
    Session("rosparam set /sci2 1.0e-3"),
    # numbers in other notations may be negative
    Session("rosparam set /n -0x10; rosparam set /m -1:30; rosparam get /n; rosparam get /m", "-16\n-90\n"),
    Session("rosparam delete /n; rosparam delete /m"),
    # deg takes one number, rad a sum without brackets; in quotes, or with brackets, it is text and is shown as such
    Session("rosparam set /g 'deg(1.5)'; rosparam get /g", "0.02617993877991494\n"),
    Session(
        "rosparam set /g '[deg(3), rad(-pi/2)]'; rosparam get /g", "- 0.05235987755982988\n- -1.5707963267948966\n\n"
    ),
    Session("rosparam set /g '\"deg(90)\"'; rosparam get /g", "'deg(90)'\n\n"),
    Session("rosparam set /g 'rad((pi+1)/2)'; rosparam get /g", "rad((pi+1)/2)\n"),
    Session(
        "rosparam set /g 'deg(180/2)'",
        "",
        "ERROR: the value 'deg(180/2)' cannot be read: 'deg(180/2)' is not an angle:"
        " expected one number of degrees; rad(...) takes a sum\n",
        1,
    ),
    Session("rosparam delete /g"),
    # a key that begins with a slash leaves the namespace, and -v tells what is set
    Session("rosparam set -v /k '{/k2: 1, l: {m: 2}}'", "set parameter [/k2] to [1]\nset parameter [/k/l/m] to [2]\n"),
    Session("rosparam load -v - /k", "reading parameters from [-]\n/k2=3\n/k/l/m=4\n", stdin="/k2: 3\nl: {m: 4}\n"),
    Session("rosparam get /k2; rosparam get /k; rosparam delete /k2; rosparam delete /k", "3\nl:\n  m: 4\n\n"),
    Session(
        "rosparam set /k '{a: ~}'",
        "",
        "ERROR: parameter /k/a: null is not a value\na parameter is a bool, a number, a string, a list or a mapping\n",
        1,
    ),
    Session("rosparam set /tags '{a: !degrees 180, b: [!radians pi/2]}'; rosparam get /tags", TAGS),
    Session("rosparam delete /tags"),
    Session(
        "rosparam set /intkey '{1: 2}'",
        "",
        "ERROR: YAML dictionaries must have string keys. Invalid dictionary is:\n{1: 2}\n",
        1,
    ),
    Session("rosparam set ~x 1"),
    Session("ROS_NAMESPACE=/ns rosparam set -v ~x 2", "set parameter [/ns/rosparam/x] to [2]\n"),
    Session("rosparam delete /ns"),
    Session("rosparam set rel 1"),
    Session("ROS_NAMESPACE=/ns rosparam set rel 2"),
    Session("rosparam set /a/b 1"),
    Session("rosparam get /a", "b: 1\n\n"),
    Session("rosparam set -t one.yaml /txt"),
    usage("rosparam set /txt -t nofile", SET, "file 'nofile' does not exist"),
    Session("rosparam set -b one.yaml /bin"),
    # get
    Session("rosparam get /f", "1.5\n"),
    Session("rosparam get f", "1.5\n"),
    Session("rosparam get / | head -n 1; echo ${PIPESTATUS[@]}", "a:\n0 0\n"),
    Session("rosparam list | head -n 1; echo ${PIPESTATUS[@]}", "/a/b\n0 0\n"),
    Session("rosparam dump | head -n 2; echo ${PIPESTATUS[@]}", "a:\n  b: 1\n0 0\n"),
    Session("rosparam get /bin | base64 -d", "data: 3.25\n"),
    Session("rosparam set /grüße 'grün'; rosparam get /grüße; rosparam delete /grüße", '"gr\\xFCn"\n\n'),
    Session("rosparam set /joint-1.2 1; rosparam set //joint-1.2//x/ 2; rosparam get /joint-1.2", "x: 2\n\n"),
    Session("rosparam delete -v /joint-1.2/", "deleted parameter [/joint-1.2/]\n"),
    Session(
        "rosparam set '/bad name' 1",
        "",
        ILLEGAL.format("/bad name") + "names have no spaces: did you mean '/bad_name'?\n",
        2,
    ),
    Session("rosparam set /text 'grün ☃'; rosparam get -p /text; rosparam get /text", GREEN),
    Session("rosparam get /neg", "-0.5\n"),
    Session("rosparam get /s", "hello\n"),
    Session("rosparam get /s2", "two words\n"),
    Session("rosparam get /e", "''\n\n"),
    Session("rosparam get /b", "true\n"),
    Session("rosparam get /num_as_str", "'1'\n\n"),
    Session("rosparam get /l", "- 1\n- 2.0\n- x\n\n"),
    Session("rosparam get /d", "d: 0.01\ni: 0.1\nnested:\n  x: 2\np: 1.0\n\n"),
    Session("rosparam get -p /d", "d: 0.01\ni: 0.1\nnested:\n  x: 2\np: 1.0\n"),
    Session(f'rosparam set /p "{PRETTY}"; rosparam get -p /p', PRETTY_LINES),
    Session("rosparam get -p /p/text", "q\nr\n\n"),
    Session("rosparam delete /p"),
    Session("rosparam get -p /l", "- 1\n- 2.0\n- x\n\n"),
    Session("rosparam get -p /s", "hello\n"),
    Session("rosparam get -v /f", "getting parameter [/f]\n1.5\n"),
    Session("rosparam get /nope", "", "ERROR: Parameter [/nope] is not set\n", 1),
    usage("rosparam get", GET, NO_NAME),
    usage("rosparam get /a /b", GET, MANY),
    Session("rosparam get /deg", "1.5707963267948966\n"),
    Session("rosparam get /rad", "1.5707963267948966\n"),
    Session("rosparam get /sci2", "0.001\n"),
    Session("rosparam get /txt", "'data: 3.25\n\n  '\n\n"),
    Session("rosparam get /x", "", "ERROR: Parameter [/x] is not set\n", 1),
    Session("rosparam get /rosparam/x", "1\n"),
    Session("rosparam get rel", "1\n"),
    Session("ROS_NAMESPACE=ns rosparam get rel", "2\n"),
    Session("rosparam get /d/nested/x", "2\n"),
    Session("rosparam get '/l[0]'", "", "ERROR: Parameter [/l[0]] is not set\n", 1),
    # list and delete
    Session("rosparam list /d", "/d/d\n/d/i\n/d/nested/x\n/d/p\n"),
    Session("rosparam list /nope", "\n"),
    Session("rosparam list /f", "\n"),
    usage("rosparam list a b", "rosparam list [namespace]", MANY),
    Session("rosparam delete /f"),
    Session("rosparam delete /f", "", "ERROR: parameter [/f] is not set\n", 1),
    Session("rosparam delete -v /s", "deleted parameter [/s]\n"),
    usage("rosparam delete", DELETE, NO_NAME),
    usage("rosparam delete /a /b", DELETE, MANY),
    Session("rosparam delete /d/nested"),
    Session("rosparam get /d", "d: 0.01\ni: 0.1\np: 1.0\n\n"),
    Session("rosparam delete /d"),
    Session("rosparam list /d", "\n"),
    # load and dump
    Session("rosparam load p.yaml"),
    Session("rosparam load p.yaml slide"),
    Session("rosparam load -v p.yaml /slide", "reading parameters from [p.yaml]\n" + LINES.replace("NS", "/slide")),
    Session("rosparam get /slide", SLIDE + "\n"),
    Session("rosparam load p2.yaml /multi"),
    Session("rosparam get /multi", "a: 1\nb: 2\n\n"),
    Session("rosparam load pns.yaml /outer"),
    Session("rosparam get /outer", "inner:\n  a: 1\n\n"),
    Session("rosparam get /sc", "", "ERROR: Parameter [/sc] is not set\n", 1),
    Session("rosparam load plist.yaml /pl"),
    Session("rosparam get /pl", "- 1\n- 2\n\n"),
    Session("rosparam load pempty.yaml /pe"),
    Session("rosparam load pempty.yaml /multi"),
    Session("rosparam get /multi", "a: 1\nb: 2\n\n"),
    Session("rosparam load psub.yaml /sub"),
    Session("rosparam get /sub", "a: $(env HOME)\n\n"),
    Session("rosparam load nofile.yaml", "", "ERROR: file [nofile.yaml] does not exist\n", 1),
    usage(
        "rosparam load",
        "rosparam load [options] file [namespace]",
        "invalid arguments. Please specify a file name or - for stdin",
    ),
    usage("rosparam load a b c", "rosparam load [options] file [namespace]", MANY),
    Session("rosparam dump out.yaml /slide"),
    Session("cat out.yaml", SLIDE),
    Session("rosparam dump - /pl", "- 1\n- 2\n"),
    Session(
        "rosparam dump -v out.yaml /slide/controller/pid",
        "dumping namespace [/slide/controller/pid] to file [out.yaml]\n"
        "/slide/controller/pid/p=100.0\n/slide/controller/pid/i=0.01\n/slide/controller/pid/d=10.0\n",
    ),
    Session(
        "rosparam dump -v out.yaml /pl; rosparam load -v out.yaml /pl2",
        "dumping namespace [/pl] to file [out.yaml]\n[1, 2]\nreading parameters from [out.yaml]\n[1, 2]\n",
    ),
    Session(
        "rosparam dump out.yaml /slide/controller/joint; rosparam load -v out.yaml /copy; rosparam get /copy",
        "reading parameters from [out.yaml]\nslide\nslide\n",
    ),
    Session(
        "rosparam dump -v out.yaml slide/nope",
        "dumping namespace [slide/nope] to file [out.yaml]\n",
        "ERROR: Parameter [/slide/nope] is not set\n",
        1,
    ),
    Session("rosparam dump out.yaml /nope", "", "ERROR: Parameter [/nope] is not set\n", 1),
    Session("rosparam load -", stdin="k: 1\n"),
    Session("rosparam load - /ns2", stdin="k: 1\n"),
    Session("rosparam get /ns2", "k: 1\n\n"),
    Session("rosparam get /k", "1\n"),
    Session("rosparam delete -v /; rosparam list; rosparam get /", "deleted ENTIRE parameter server\n\n{}\n\n"),
]


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Shell, Path]]:
    folder = tmp_path_factory.mktemp("parameters")
    for name, text in FILES.items():
        (folder / name).write_text(text, encoding="utf-8")
    with running_daemon(paused=True) as daemon:
        yield Shell(CommandLine(daemon.folder)), folder


def test_the_recorded_sessions_in_their_order(shell: tuple[Shell, Path]) -> None:
    bash, folder = shell
    for session in SESSIONS:
        done = bash.run(session.line, session.stdin, folder)
        assert (session.line, done.stdout, done.stderr) == (session.line, session.stdout, session.stderr)
        assert (session.line, done.returncode) == (session.line, session.code)


REFUSED = [
    ("rosparam set /bad 'a: [1'", "not valid YAML"),
    ("rosparam set /null null", "a parameter cannot be null"),
    ("rosparam set /date 2020-01-01", "is a date"),
    ("rosparam set /big 3000000000", "integers have 32 bits; write 3000000000.0"),
    ("rosparam set /huge '[1, 99999999999999999999]'", "integers have 32 bits"),
    ("rosparam set /inf .inf", "finite"),
    ("rosparam load pscalar.yaml /sc", "pscalar.yaml:1: "),
    ("rosparam load pbad.yaml", "pbad.yaml:2: "),
    ("rosparam dump /nodir/x.yaml", "cannot write [/nodir/x.yaml]"),
]


@pytest.mark.parametrize(("line", "text"), REFUSED, ids=[line for line, _ in REFUSED])
def test_where_the_real_tool_ends_with_a_traceback_there_is_one_error(
    shell: tuple[Shell, Path], line: str, text: str
) -> None:
    bash, folder = shell
    done = bash.run(line, cwd=folder)
    assert (done.stdout, done.returncode) == ("", 1)
    assert done.stderr.startswith("ERROR: ")
    assert text in done.stderr


def test_a_number_without_a_point_is_a_number(shell: tuple[Shell, Path]) -> None:
    assert shell[0].run("rosparam set /sci 1e-3; rosparam get /sci").stdout == "0.001\n"


def test_the_last_of_two_equal_keys_counts_and_is_pointed_out(shell: tuple[Shell, Path]) -> None:
    bash, folder = shell
    done = bash.run("rosparam load pdup.yaml /dup; rosparam get /dup", cwd=folder)
    assert done.stdout == "a: 2\n\n"
    assert "pdup.yaml:2: a duplicate key" in done.stderr


def test_a_list_of_names_ends_with_a_line_end_only(shell: tuple[Shell, Path]) -> None:
    done = shell[0].run("rosparam set /one/x 1; rosparam list /one | od -c")
    assert done.stdout.split() == ["0000000", "/", "o", "n", "e", "/", "x", "\\n", "0000007"]


def test_without_a_verb_the_list_of_verbs_is_success(shell: tuple[Shell, Path]) -> None:
    for line in ("rosparam", "rosparam bogus", "rosparam -h"):
        done = shell[0].run(line)
        assert (done.returncode, done.stderr) == (0, "")
        for verb in ("set", "get", "load", "dump", "delete", "list"):
            assert f"rosparam {verb}" in done.stdout


def test_without_a_daemon_the_code_is_3(shell: tuple[Shell, Path]) -> None:
    for words in ("list", "get /a", "set /a 1", "delete /a", "dump x.yaml", "dump"):
        done = shell[0].slidectl("-i", "nobody", "ros", "rosparam", *words.split())
        assert (done.returncode, done.stdout) == (3, "")
        assert done.stderr.splitlines()[0] == "ERROR: Unable to communicate with master!"
