"""Python packages of messages: FOLDER/definitions/PACKAGE/{msg,srv} -> FOLDER/python, for those that ROS has not."""

import importlib
import sys
from pathlib import Path

import genmsg.command_line
import genpy.generate_initpy
import genpy.generator


def is_there(package, definitions):
    """True when ROS has the package, with all types that are defined here."""
    for kind in ("msg", "srv"):
        names = [file.stem for file in (definitions / package / kind).glob("*")]
        try:
            module = importlib.import_module(f"{package}.{kind}") if names else None
        except ImportError:
            return False
        if not all(hasattr(module, name) for name in names):
            return False
    return True


def main():
    folder, packages = Path(sys.argv[1]), sys.argv[2:]
    definitions = folder / "definitions"
    search = genmsg.command_line.includepath_to_dict([f"{name}:{definitions / name / 'msg'}" for name in packages])
    (folder / "python").mkdir()
    for package in packages:
        if is_there(package, definitions):
            continue
        out = folder / "python" / package
        out.mkdir()
        (out / "__init__.py").touch()
        for kind, generator in (("msg", genpy.generator.MsgGenerator()), ("srv", genpy.generator.SrvGenerator())):
            files = [str(file) for file in (definitions / package / kind).glob("*")]
            if files:
                (out / kind).mkdir()
                if generator.generate_messages(package, files, str(out / kind), search):
                    sys.exit(f"the messages of {package} could not be made")
                genpy.generate_initpy.write_modules(str(out / kind))
        print(package)


main()
