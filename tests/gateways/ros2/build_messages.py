"""Message packages of ROS 2 from their sources, with the generators among rclpy's wheels: FOLDER_OF_SOURCES MADE.

Run by the Python of an environment with those wheels. MADE becomes a folder for PYTHONPATH and LD_LIBRARY_PATH. A
package in it is one shared library beside its modules, under each of the names by which Python and Fast DDS load it.
"""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path
from typing import Any

import numpy
from rosidl_adapter import convert_to_idl
from rosidl_generator_c import generate_c
from rosidl_generator_py import generate_py
from rosidl_generator_type_description import generate_type_hash
from rosidl_typesupport_c import generate_c as generate_typesupport_c
from rosidl_typesupport_fastrtps_c import generate_typesupport_fastrtps_c
from rosidl_typesupport_introspection_c import generate_c as generate_introspection_c

PREFIX = Path(sys.prefix)
SHARE, LIBRARIES = PREFIX / "share", PREFIX / "lib"
INTROSPECTION, FASTRTPS = "rosidl_typesupport_introspection_c", "rosidl_typesupport_fastrtps_c"
DESCRIPTIONS = "rosidl_generator_type_description"


class Package:
    """One package: `sources` holds its folders msg, srv and action; `made` gets its modules and its library."""

    def __init__(self, sources: Path, made: Path, scratch: Path) -> None:
        self.name = sources.name
        self.made = made
        self.scratch = scratch
        """A folder for each generator, in which the code of a package is in a folder of its name."""
        self.sources = sources
        self.files = sorted(path for kind in ("msg", "srv", "action") for path in sources.glob(f"{kind}/*.{kind}"))
        self.idls: list[Path] = []

    def generate(self) -> None:
        """Write the package in C, C++ and Python."""
        own = self._folder("idl")
        for path in self.files:
            made = convert_to_idl(self.sources, self.name, path.relative_to(self.sources), own)
            self.idls.append(made.relative_to(own))
        known = [f"{path.parent.name}:{path.parent}" for path in SHARE.glob("*/msg")]
        generate_type_hash(self._arguments(DESCRIPTIONS, include_paths=known))
        described = [f"{idl}:{self._folder(DESCRIPTIONS) / idl.with_suffix('.json')}" for idl in self.idls]
        sources = [str(path) for path in self.files]
        generate_c(
            self._arguments("rosidl_generator_c", type_description_tuples=described, ros_interface_files=sources)
        )
        generate_typesupport_c(self._arguments("rosidl_typesupport_c"), [FASTRTPS, INTROSPECTION])
        generate_typesupport_fastrtps_c(self._arguments(FASTRTPS))
        generate_introspection_c(self._arguments(INTROSPECTION))
        for generator in ("rosidl_generator_c", FASTRTPS, INTROSPECTION):
            template = SHARE / generator / "resource" / f"{generator}__visibility_control.h.in"
            text = template.read_text("utf-8").replace("@PROJECT_NAME_UPPER@", self.name.upper())
            header = self._folder(generator) / "msg" / template.stem
            header.parent.mkdir(exist_ok=True)
            header.write_text(text.replace("@PROJECT_NAME@", self.name), "utf-8")
        generate_py(self._arguments("rosidl_generator_py"), ["rosidl_typesupport_c"])

    def _folder(self, generator: str) -> Path:
        folder = self.scratch / generator / self.name
        folder.mkdir(parents=True, exist_ok=True)
        return folder

    def _arguments(self, generator: str, **more: Any) -> str:
        """The file of a generator's arguments."""
        given = {
            "package_name": self.name,
            "output_dir": str(self._folder(generator)),
            "template_dir": str(SHARE / generator / "resource"),
            "idl_tuples": [f"{self._folder('idl')}:{idl}" for idl in self.idls],
            "target_dependencies": [],
        }
        file = self.scratch / f"{self.name}-{generator}.json"
        file.write_text(json.dumps({**given, **more}), "utf-8")
        return str(file)

    def install(self) -> None:
        """Compile the package, and put its modules and its library where they are found."""
        modules = self.made / self.name
        shutil.copytree(self._folder("rosidl_generator_py"), modules, ignore=shutil.ignore_patterns("*.c"))
        (modules / "__init__.py").touch()
        library = modules / f"{self.name}_s__rosidl_typesupport_c{sysconfig.get_config_var('EXT_SUFFIX')}"
        all_cpp = self.scratch / f"{self.name}.cpp"  # in one: the headers that they share take most of the time
        all_cpp.write_text("".join(f'#include "{path}"\n' for path in self._generated("*.cpp")), "utf-8")
        included = [*self.scratch.iterdir(), *(PREFIX / "include").iterdir(), PREFIX / "include"]
        included += [numpy.get_include(), sysconfig.get_path("include")]
        kinds = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_c", FASTRTPS, INTROSPECTION)
        linked = [path for kind in kinds for path in LIBRARIES.glob(f"lib*__{kind}.so")]
        linked += [LIBRARIES / f"lib{name}.so" for name in
                   ("rosidl_runtime_c", "rosidl_typesupport_c", FASTRTPS, INTROSPECTION,
                    "rosidl_typesupport_fastrtps_cpp", "fastcdr")]  # fmt: skip
        words = ["gcc", "-shared", "-fPIC", "-w", *(f"-I{folder}" for folder in included), "-o", library,
                 *self._generated("*.c"), all_cpp, "-Wl,--as-needed", *linked, "-lstdc++"]  # fmt: skip
        subprocess.run(words, check=True)
        for kind in (FASTRTPS, INTROSPECTION):
            (self.made / f"lib{self.name}__{kind}.so").symlink_to(library.relative_to(self.made))

    def _generated(self, pattern: str) -> list[Path]:
        return sorted(self.scratch.glob(f"*/{self.name}/**/{pattern}"))


def main() -> None:
    sources, made = (Path(word).absolute() for word in sys.argv[1:])
    made.mkdir()
    with tempfile.TemporaryDirectory() as scratch:
        for folder in sorted(path for path in sources.iterdir() if path.is_dir()):
            package = Package(folder, made, Path(scratch))
            package.generate()
            package.install()


main()
