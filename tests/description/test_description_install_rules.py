"""A package of ROS 2 in source: files are found where its installation would put them."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path

import pytest

from slidectl import description
from slidectl.description import Packages, install_rules
from slidectl.description.robot import Mesh
from slidectl.errors import BadFile, NotThere

Write = Callable[[str, str], Path]

TETRAHEDRON = """solid t
facet normal 0 0 -1
outer loop
vertex 0 0 0
vertex 0 1 0
vertex 1 0 0
endloop
endfacet
facet normal 0 -1 0
outer loop
vertex 0 0 0
vertex 1 0 0
vertex 0 0 1
endloop
endfacet
facet normal -1 0 0
outer loop
vertex 0 0 0
vertex 0 0 1
vertex 0 1 0
endloop
endfacet
facet normal 1 1 1
outer loop
vertex 1 0 0
vertex 0 1 0
vertex 0 0 1
endloop
endfacet
endsolid t
"""


@pytest.fixture
def package(write: Write, tmp_path: Path) -> Path:
    """The folder of a package `bot` with an empty CMakeLists.txt; its folder has another name."""
    write("ws/example_1/package.xml", "<package format='3'><name>bot</name></package>")
    write("ws/example_1/CMakeLists.txt", "project(bot)\n")
    return tmp_path / "ws" / "example_1"


def _installed(package: Path, place: str, cmake: str) -> str:
    """Where a CMakeLists.txt has the file at `place` from, inside the package."""
    (package / "CMakeLists.txt").write_text(f"cmake_minimum_required(VERSION 3.16)\nproject(bot)\n{cmake}\n")
    return install_rules.located(package / place).relative_to(package).as_posix()


@pytest.mark.parametrize(
    ("cmake", "place"),
    [
        ("install(DIRECTORY a/urdf other DESTINATION share/${PROJECT_NAME})", "urdf/deep/x.xacro"),
        ("INSTALL(DIRECTORY a/urdf\n  DESTINATION share/bot/m/ FILES_MATCHING PATTERN x)", "m/urdf/deep/x.xacro"),
        ("install(DIRECTORY a/urdf/ DESTINATION share/${PROJECT_NAME}/models)", "models/deep/x.xacro"),
        ("install(DIRECTORY ${bot_SOURCE_DIR}/a/ DESTINATION ${CMAKE_INSTALL_PREFIX}/share/bot)", "urdf/deep/x.xacro"),
        ('install(DIRECTORY "a/urdf" DESTINATION "${CMAKE_INSTALL_DATADIR}/${PROJECT_NAME}")', "urdf/deep/x.xacro"),
        ("install(FILES a/urdf/deep/x.xacro DESTINATION share/bot/urdf)", "urdf/x.xacro"),
        ("install(FILES a/urdf/deep/x.xacro DESTINATION share/bot RENAME robot.xacro)", "robot.xacro"),
        ("set(FOLDERS b a/urdf)\ninstall(DIRECTORY ${FOLDERS} DESTINATION share/bot)", "urdf/deep/x.xacro"),
        ("foreach(f b a)\ninstall(DIRECTORY ${f}/ DESTINATION share/bot/${f}_)\nendforeach()", "a_/urdf/deep/x.xacro"),
        ("set(L a)\nforeach(f IN LISTS L)\ninstall(DIRECTORY ${f}/urdf DESTINATION share/bot)\nendforeach()",
         "urdf/deep/x.xacro"),
        ("file(GLOB X ${CMAKE_CURRENT_SOURCE_DIR}/a/urdf/deep/*.xacro)\ninstall(FILES ${X} DESTINATION share/bot/m)",
         "m/x.xacro"),
        ("ament_auto_package(INSTALL_TO_SHARE launch a/urdf)", "urdf/deep/x.xacro"),
        ("if(X)\n# install(DIRECTORY b\ninstall(DIRECTORY a/urdf # here\n DESTINATION share/bot)\nendif()",
         "urdf/deep/x.xacro"),
        ("#[[ install(DIRECTORY b (\n]]install(DIRECTORY a/urdf DESTINATION share/bot)", "urdf/deep/x.xacro"),
    ],
)  # fmt: skip
def test_a_file_is_found_where_cmake_would_install_it(write: Write, package: Path, cmake: str, place: str) -> None:
    write("ws/example_1/a/urdf/deep/x.xacro", "")
    assert _installed(package, place, cmake) == "a/urdf/deep/x.xacro"


@pytest.mark.parametrize(
    "cmake",
    [
        "install(DIRECTORY a/urdf DESTINATION lib/${PROJECT_NAME})",
        "install(DIRECTORY a/urdf DESTINATION share/another)",
        "install(DIRECTORY a/${UNKNOWN} a/urdf2 DESTINATION share/bot)",
        "install(DIRECTORY a/urdf/ DESTINATION share/bot)",
        "install(DIRECTORY a/urdf)",
        "install(DIRECTORY a/urdf DESTINATION",
    ],
)
def test_what_cmake_does_not_install_there_is_not_found(write: Write, package: Path, cmake: str) -> None:
    write("ws/example_1/a/urdf/x.xacro", "")
    assert _installed(package, "urdf/x.xacro", cmake) == "urdf/x.xacro"


@pytest.mark.parametrize(
    "files",
    [
        "[(os.path.join('share', package_name, 'urdf'), glob('models/*.xacro'))]",
        "[('share/' + package_name + '/urdf', ['models/a.xacro'])]",
        "[(f'share/{package_name}/urdf', glob.glob(os.path.join('models', '*')))]",
        "[*generated(), unknown, ('share/' + name, []), (join('share', package_name, 'urdf'), ('models/a.xacro',))]",
        "data_files",
        "data_files + [('share/bot', ['package.xml'])]",
    ],
)
def test_a_file_is_found_where_setup_py_would_install_it(write: Write, package: Path, files: str) -> None:
    source = write("ws/example_1/models/a.xacro", "")
    write(
        "ws/example_1/setup.py",
        "import os\nfrom setuptools import setup\n\npackage_name = 'bot'\n"
        "data_files = []\ndata_files.append((os.path.join('share', package_name, 'urdf'), glob('models/a.*')))\n"
        "raise SystemExit('this file is not run')\n"
        f"setup(name=package_name, data_files={files})\n",
    )
    assert install_rules.located(package / "urdf" / "a.xacro") == source
    absent = package / "urdf" / "b.xacro"
    assert install_rules.located(absent) == absent


def test_a_file_is_found_where_setup_cfg_would_install_it(write: Write, package: Path) -> None:
    sources = [write(f"ws/example_1/models/{name}", "") for name in ("a.xacro", "b.urdf")]
    write(
        "ws/example_1/setup.cfg",
        "[metadata]\nname = bot\n[options.data_files]\nshare/bot/urdf =\n  models/*.xacro\n  models/b.urdf\n",
    )
    assert [install_rules.located(package / "urdf" / source.name) for source in sources] == sources


def test_a_file_in_source_goes_before_one_that_would_be_installed(write: Write, package: Path) -> None:
    write("ws/example_1/urdf/x.xacro", "")
    write("ws/example_1/description/urdf/x.xacro", "")
    cmake = "install(DIRECTORY description/urdf DESTINATION share/bot)"
    assert _installed(package, "urdf/x.xacro", cmake) == "urdf/x.xacro"


def test_a_model_with_all_its_files_is_read_as_if_it_were_installed(write: Write, package: Path) -> None:
    """Includes, YAML, meshes by package://, by file:// and beside the file that names them."""
    (package / "CMakeLists.txt").write_text(
        "project(bot)\ninstall(DIRECTORY description/urdf description/meshes DESTINATION share/bot)\n"
        "install(DIRECTORY bringup/config DESTINATION share/bot)\n"
    )
    model = write(
        "ws/example_1/description/urdf/bot.urdf.xacro",
        '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
        '<xacro:include filename="$(find bot)/urdf/parts/link.xacro"/>\n'
        "<xacro:property name=\"size\" value=\"${xacro.load_yaml('$(find bot)/config/size.yaml')['size']}\"/>\n"
        "<xacro:property name=\"again\" value=\"${xacro.load_yaml('../config/size.yaml')['size']}\"/>\n"
        '<link name="world"/><xacro:one name="a" mesh="package://bot/meshes/t.stl" size="${size + again}"/>\n'
        '<xacro:one name="b" mesh="file://$(find bot)/meshes/t.stl" size="1"/>\n'
        '<xacro:one name="c" mesh="../meshes/t.stl" size="1"/></robot>',
    )
    write(
        "ws/example_1/description/urdf/parts/link.xacro",
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename="more.xacro"/>'
        '<xacro:macro name="one" params="name mesh size"><xacro:mass/><link name="${name}">'
        '<collision><geometry><mesh filename="${mesh}" scale="${size} 1 1"/></geometry></collision></link>'
        '<joint name="to_${name}" type="fixed"><parent link="world"/><child link="${name}"/></joint>'
        "</xacro:macro></robot>",
    )
    write(
        "ws/example_1/description/urdf/parts/more.xacro",
        '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="mass" params=""/>'
        '<xacro:arg name="deep" default="5"/></robot>',
    )
    write("ws/example_1/bringup/config/size.yaml", "size: 2")
    mesh = write("ws/example_1/description/meshes/t.stl", TETRAHEDRON)
    document = description.load(model)
    robot = description.parse(document.xml, document.file)
    shapes = {name: link.collisions[0].geometry for name, link in robot.links.items() if name != "world"}
    found = {n: (Path(s.path or "").resolve(), s.scale) for n, s in shapes.items() if isinstance(s, Mesh)}
    assert found == {name: (mesh.resolve(), (x, 1, 1)) for name, x in (("a", 4), ("b", 1), ("c", 1))}
    assert list(description.written(model).arguments) == ["deep"]


def test_an_error_in_a_file_in_source_names_that_file(write: Write, package: Path) -> None:
    (package / "CMakeLists.txt").write_text("install(DIRECTORY description/urdf DESTINATION share/bot)")
    text = '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">\n%s</robot>'
    write("ws/example_1/description/urdf/part.xacro", text % '<link name="${nothing}"/>')
    model = write("ws/example_1/bot.xacro", text % '<xacro:include filename="$(find bot)/urdf/part.xacro"/>')
    with pytest.raises(BadFile, match=r"/example_1/description/urdf/part.xacro:2: name 'nothing' is not defined"):
        description.load(model)


@pytest.mark.parametrize(
    ("file", "hint"),
    [
        ("urdf/part.xacro", "CMakeLists.txt:2 installs it from .*/description/urdf/part.xacro, which is not there e"),
        ("xacro/part.xacro", "the package bot does not install it; it installs by CMakeLists.txt: launch, urdf"),
    ],
)  # fmt: skip
def test_an_error_says_which_rule_was_tried(write: Write, package: Path, file: str, hint: str) -> None:
    (package / "CMakeLists.txt").write_text("\ninstall(DIRECTORY description/urdf launch DESTINATION share/bot)")
    text = '<robot name="bot" xmlns:xacro="http://www.ros.org/wiki/xacro">%s</robot>'
    model = write("ws/example_1/bot.xacro", text % f'<xacro:include filename="$(find bot)/{file}"/>')
    with pytest.raises(NotThere, match=f"no such file or directory: {package}/{file}") as caught:
        description.load(model)
    assert caught.value.hint is not None
    caught.match(hint)
    read = f"${{xacro.load_yaml('$(find bot)/{file}')}}"
    write("ws/example_1/bot.xacro", text % f'<link name="{read}"/>')
    with pytest.raises(BadFile, match=hint):
        description.load(model)
    mesh = f'<link name="a"><collision><geometry><mesh filename="package://bot/{file}"/></geometry></collision></link>'
    write("ws/example_1/bot.xacro", text % mesh)
    with pytest.raises(NotThere, match=f"looked for {package}/{file}; {hint}"):
        description.load(model)


def test_no_rule_leads_out_of_the_package(write: Write, package: Path) -> None:
    secret = write("ws/secret.yaml", "")
    for source, place in (("..", "x/secret.yaml"), ("a/../..", "x/secret.yaml"), (str(secret.parent), "x/secret.yaml")):
        rule = (
            f"install(DIRECTORY {source}/ DESTINATION share/bot/x)\ninstall(FILES {source}/secret.yaml DESTINATION x)"
        )
        assert _installed(package, place, rule) == place
    inside = "install(DIRECTORY a DESTINATION share/bot)"
    assert install_rules.located(package / "b/../../nothing.yaml") == package / "b/../../nothing.yaml"
    assert _installed(package, "a/../../secret2.yaml", inside) == "a/../../secret2.yaml"


@pytest.mark.parametrize(
    ("file", "text"),
    [
        ("CMakeLists.txt", "set(A a a)\n" + "set(A ${A} ${A})\n" * 3000 + "install(FILES ${A} DESTINATION share/b)"),
        ("CMakeLists.txt", 'set(A aaaa)\n' + 'set(A "${A}${A}")\n' * 3000 + "install(FILES ${A} DESTINATION x)"),
        ("CMakeLists.txt", "set(A" + " a" * 300 + ")\n" + "foreach(x ${A})\n" * 1500 + "set(B ${A})\n"),
        ("CMakeLists.txt", "foreach()\nfile(GLOB)\nset()\ninstall()\ninstall(FILES)\n" * 1000),
        ("CMakeLists.txt", "(" * 60_000),
        ("CMakeLists.txt", "#[[ " * 15_000),
        ("CMakeLists.txt", '"' + "\\" * 60_000),
        ("CMakeLists.txt", "install(DIRECTORY a DESTINATION share/bot)\n" * 100_000),
        ("setup.py", "a = 'aaaa'\n" + "a = a + a\n" * 5000 + "setup(data_files=[('share/bot', [a])])"),
        ("setup.py", "a = [('share/bot', ['x'])]\n" + "a += a\n" * 5000 + "setup(data_files=a)"),
        ("setup.py", "setup(data_files=" + "-" * 60_000 + "1)"),
        ("setup.py", "setup(data_files=a" + "+a" * 30_000 + ")"),
        ("setup.py", "setup(data_files=a" + ".a" * 30_000 + ")"),
        ("setup.py", "x = " + "[" * 60_000),
        ("setup.py", "setup(\0"),
        ("setup.cfg", "[options.data_files]\n" + "share/bot = " + "a," * 30_000),
        ("setup.cfg", "[[["),
    ],
    ids=lambda value: value[:25],
)  # fmt: skip
def test_a_hostile_build_file_costs_little_and_finds_nothing(write: Write, package: Path, file: str, text: str) -> None:
    write(f"ws/example_1/{file}", text)
    begun = time.process_time()
    assert install_rules.located(package / "urdf/x") == package / "urdf/x"
    install_rules.remark(package / "b/../urdf/x")
    assert time.process_time() - begun < 3


def test_a_package_in_source_is_found_by_its_name_beside_a_package_that_asks(write: Write, package: Path) -> None:
    other = write("ws/example_2/urdf/x.xacro", "").parent
    write("ws/example_2/package.xml", "<package><name>other</name></package>")
    assert Packages(start=other).find("bot") == package
    write("ws/bot/package.xml", "<package><name>bot</name></package>")
    assert Packages(start=other).find("bot") == package.parent / "bot"


@pytest.mark.parametrize("mark", ["share/ament_index/resource_index/packages/arm", "share/arm/package.xml"])
@pytest.mark.parametrize("variable", ["AMENT_PREFIX_PATH", "COLCON_PREFIX_PATH"])
def test_installed_packages_are_found_and_named(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, mark: str, variable: str
) -> None:
    write(f"install/{mark}", "")
    monkeypatch.setenv(variable, f"/no/such/folder:{tmp_path / 'install'}")
    assert Packages().find("arm") == tmp_path / "install/share/arm"
    with pytest.raises(description.UnknownPackage, match=f"{variable}=/no/such/folder:{tmp_path / 'install'}"):
        Packages().find("ar/m")


def test_installed_packages_of_colcon_may_have_folders_of_their_own(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write("install/arm/share/arm/package.xml", "")
    monkeypatch.setenv("COLCON_PREFIX_PATH", str(tmp_path / "install"))
    assert Packages().find("arm") == tmp_path / "install/arm/share/arm"


def test_a_package_in_source_goes_before_an_installed_one_and_that_before_a_shipped_one(
    write: Write, package: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("bot", "rrbot_description"):
        write(f"install/share/{name}/package.xml", "")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    packages = Packages(start=package / "urdf")
    assert packages.find("bot") == package
    assert packages.find("rrbot_description") == tmp_path / "install/share/rrbot_description"


def test_a_wrong_name_is_compared_with_those_of_installed_packages(
    write: Write, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write("install/share/ament_index/resource_index/packages/arm_description", "")
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path / "install"))
    with pytest.raises(description.UnknownPackage, match="Did you mean 'arm_description'"):
        Packages().find("arm_descriptions")
