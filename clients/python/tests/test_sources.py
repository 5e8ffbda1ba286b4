"""The sources hold what they promise: types, style, generated code, fields of the server, a package to install."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
import zipfile
from pathlib import Path

from conftest import CHECKOUT

from palpate import documents

CLIENT = CHECKOUT / "clients/python"
WIRE = CHECKOUT / "server/wire"
REPORTS = CHECKOUT / "calibration/reports/src"


def run(*command: str | Path) -> str:
    done = subprocess.run(
        [sys.executable, "-m", *map(str, command)], cwd=CLIENT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, f"{command[0]} says:\n{done.stdout}{done.stderr}"
    return done.stdout


def test_types_are_strict() -> None:
    run("mypy")


def test_style_is_kept() -> None:
    run("ruff", "check", ".")
    run("ruff", "format", "--check", ".")


def test_generated_modules_are_those_of_the_proto_files(tmp_path: Path) -> None:
    protos = [WIRE / "proto/palpate/control.proto", WIRE / "proto/palpate/trace.proto"]
    run("grpc_tools.protoc", f"-I{WIRE / 'proto'}", f"--python_out={tmp_path}", f"--pyi_out={tmp_path}", *protos)
    made = sorted((tmp_path / "palpate").iterdir())
    assert len(made) == 4
    for path in made:
        committed = CLIENT / "src/palpate" / path.name
        assert path.read_text() == committed.read_text(), f"{path.name} is old: README.md says how to make it anew"


def test_documents_have_the_fields_of_the_server() -> None:
    sources = [WIRE / "src/api.rs", *(WIRE / "src/api").glob("*.rs"), *REPORTS.glob("*.rs")]
    text = "\n".join(path.read_text() for path in sources)
    structs = {}
    for name, body in re.findall(r"pub struct (\w+)(?:<[^>]*>)? \{\n(.*?)\n\}", text, re.DOTALL):
        fields = re.findall(r"((?:\s*#\[[^\n]*\n)*)\s*pub (\w+):", re.sub(r"^\s*///.*\n", "", body, flags=re.MULTILINE))
        renames = [(re.search(r'rename = "(\w+)"', attributes), field) for attributes, field in fields]
        structs[name] = {rename[1] if rename else field for rename, field in renames}
    compared = 0
    for name, kind in vars(documents).items():
        if isinstance(kind, type) and dataclasses.is_dataclass(kind):
            ours = {field.name.rstrip("_") for field in dataclasses.fields(kind)}
            assert ours == structs[name], f"{name} differs from the server's"
            compared += 1
    assert compared > 40


def test_the_package_installs_with_its_types_and_its_command(tmp_path: Path) -> None:
    run("pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "--wheel-dir", tmp_path, CLIENT)
    (wheel,) = tmp_path.glob("palpate-*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        assert "palpate/py.typed" in names
        assert "palpate/trace_pb2.pyi" in names
        entries = next(name for name in names if name.endswith("entry_points.txt"))
        assert "palpate-viser = palpate.viser:main" in archive.read(entries).decode()
