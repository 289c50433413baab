"""The wheel: it carries the configurations and the free set, nothing else, and works away from the checkout."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import subprocess
import sys
import zipfile
from email import message_from_string
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import pytest

from tests.imports import ROOT, modules, within
from tests.reference import reference_or_skip

PACKAGES = ("dgrasp", "raisim_like")
BUNDLED = "dgrasp/_bundled/"
IMPORTED_AS = {
    "fast-simplification": "fast_simplification", "imageio-ffmpeg": "imageio_ffmpeg", "mujoco-warp": "mujoco_warp",
    "pillow": "PIL", "pyyaml": "yaml", "warp-lang": "warp",
}  # fmt: skip
"""Distributions whose modules have another name."""
PAGE = ("page.js", "report.css", "viewer.js")
JUNK = (
    "data/dexycb/labels/dexycb_train_labels.pkl",
    "data/my_grasps.npz",
    "dgrasp/__pycache__/config.cpython-311.pyc",
    "cfg/notes.txt~",
    "runs/first/config.yaml",
    "tests/test_something.py",
)
"""What lies about in a checkout that is used, and must not be shipped."""


def run(*command: str, cwd: Path, **environment: str) -> str:
    done = subprocess.run(command, cwd=cwd, env={**os.environ, **environment}, capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(command)}: exit code {done.returncode}\n{done.stdout}\n{done.stderr}"
    return done.stdout


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The wheel of a copy of this tree (a build leaves folders behind), by way of the source archive."""
    work = tmp_path_factory.mktemp("package")
    copy = work / "tree"
    for folder in (*PACKAGES, "cfg", "data/free"):
        shutil.copytree(ROOT / folder, copy / folder, ignore=shutil.ignore_patterns("__pycache__"))
    for pattern in ("pyproject.toml", "setup.py", "MANIFEST.in", "LICENSE", "README*", "data/README*"):
        for path in ROOT.glob(pattern):
            shutil.copy(path, copy / path.relative_to(ROOT))
    for name in JUNK:
        (copy / name).parent.mkdir(parents=True, exist_ok=True)
        (copy / name).write_bytes(b"junk")
    run(sys.executable, "-c", "from setuptools.build_meta import build_sdist; build_sdist('..')", cwd=copy)
    (archive,) = work.glob("dgrasp-*.tar.gz")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "wheel", "--no-deps", "--no-build-isolation")
    run(*pip, "--no-index", str(archive), cwd=work)
    (built,) = work.glob("dgrasp-*.whl")
    return built


@pytest.fixture(scope="module")
def contents(wheel: Path) -> dict[str, bytes]:
    """The wheel's files by their paths in it."""
    with zipfile.ZipFile(wheel) as archive:
        return {name: archive.read(name) for name in archive.namelist()}


@pytest.fixture(scope="module")
def installed(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder that the wheel is installed into."""
    target = tmp_path_factory.mktemp("installed")
    pip = (sys.executable, "-m", "pip", "--disable-pip-version-check", "install", "--no-deps", "--no-index")
    run(*pip, "--target", str(target), str(wheel), cwd=target)
    return target


def shipped(folder: str, pattern: str) -> dict[str, bytes]:
    """The checkout's files by the paths that they should have in the wheel's bundle."""
    found = (p for p in (ROOT / folder).rglob(pattern) if p.is_file() and "__pycache__" not in p.parts)
    return {BUNDLED + p.relative_to(ROOT).as_posix(): p.read_bytes() for p in found}


def test_every_module_is_in_the_wheel(contents: dict[str, bytes]) -> None:
    expected = {p.relative_to(ROOT).as_posix() for package in PACKAGES for p in (ROOT / package).rglob("*.py")}
    packed = {name for name in contents if name.endswith(".py")}
    assert packed == expected, "a new subpackage belongs into the list of packages in pyproject.toml"


def test_the_bundle_is_the_configurations_and_the_free_set(contents: dict[str, bytes]) -> None:
    expected = shipped("cfg", "*.yaml") | shipped("data/free", "*")
    expected |= {BUNDLED + f"data/{p.name}": p.read_bytes() for p in (ROOT / "data").glob("README*")}
    assert BUNDLED + "cfg/dexycb.yaml" in expected
    assert BUNDLED + "data/free/hand/free_hand.urdf" in expected
    assert {name: data for name, data in contents.items() if name.startswith(BUNDLED)} == expected


def test_nothing_else_is_in_the_wheel(contents: dict[str, bytes]) -> None:
    carried = {"dgrasp/eval/paper_tables.yaml", *(f"dgrasp/report/{name}" for name in PAGE)}
    assert carried <= set(contents)
    others = {name for name in contents if not name.endswith((".py", *EXTENSION_SUFFIXES))}
    others = {name for name in others if not name.startswith(BUNDLED)}
    assert {name for name in others if ".dist-info/" not in name} == carried
    assert b"junk" not in contents.values()


def test_no_file_of_the_authors_release_is_in_the_wheel(contents: dict[str, bytes]) -> None:
    release = {hashlib.sha256(p.read_bytes()).digest() for p in reference_or_skip().rglob("*") if p.is_file()}
    assert [name for name, data in contents.items() if hashlib.sha256(data).digest() in release] == []


def test_an_installed_package_finds_what_it_carries(installed: Path, tmp_path: Path) -> None:
    code = (
        "import json, dgrasp.files.paths as p\n"
        "found = [p.package_file('cfg/dexycb.yaml'), p.package_file('data/free/hand/free_hand.urdf')]\n"
        "print(json.dumps([p.is_checkout(), *map(str, [p.PACKAGE, *found, p.user_data_root()])]))"
    )
    is_checkout, *paths = json.loads(run(sys.executable, "-c", code, cwd=tmp_path, PYTHONPATH=str(installed)))
    bundle = installed / "dgrasp" / "_bundled"
    assert not is_checkout
    assert [Path(p) for p in paths] == [
        installed / "dgrasp",
        bundle / "cfg/dexycb.yaml",
        bundle / "data/free/hand/free_hand.urdf",
        tmp_path / "data",
    ]


def test_the_checkout_is_not_taken_for_an_installed_package() -> None:
    assert not (ROOT / "dgrasp" / "_bundled").exists()


def test_the_command_line_works_away_from_the_checkout(installed: Path, tmp_path: Path) -> None:
    text = run(sys.executable, "-m", "dgrasp.cli", "--help", cwd=tmp_path, PYTHONPATH=str(installed))
    assert "train" in text and "test" in text
    assert run(str(installed / "bin" / "dgrasp"), "--help", cwd=tmp_path, PYTHONPATH=str(installed)) == text


def test_the_dependencies_are_what_the_code_imports(contents: dict[str, bytes]) -> None:
    (name,) = (name for name in contents if name.endswith(".dist-info/METADATA"))
    metadata = message_from_string(contents[name].decode())
    declared = {
        requirement.split(">")[0].split("<")[0].split("=")[0].strip()
        for requirement in metadata.get_all("Requires-Dist", [])
        if 'extra == "dev"' not in requirement
    }
    used = {name.split(".")[0] for package in PACKAGES for _, names in modules(package) for name in names}
    third_party = {name for name in used if name not in sys.stdlib_module_names and not within(name, *PACKAGES)}
    assert {IMPORTED_AS.get(distribution, distribution) for distribution in declared} == third_party
    assert metadata["Requires-Python"] == ">=3.10"
