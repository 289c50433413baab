"""`dgrasp object add` as users type it, and what they do next: labels, and test.py on them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest

from dgrasp.build import build_objects
from dgrasp.cli import main, run_command
from dgrasp.config.experiment import load_config
from dgrasp.data import resolve
from dgrasp.hand.mano.layout import MANO_NAMES
from dgrasp.labels.formats.native import write_native
from dgrasp.objects.store import StoredObject
from tests.commands.folder import make_folder
from tests.objects.meshes import box, save
from tests.scenes import free_hand, make_label


@pytest.fixture(autouse=True)
def cache(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("DGRASP_CACHE", str(tmp_path_factory.getbasetemp() / "add_cache"))


def test_from_a_mesh_to_a_result(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    mesh = save(box((0.038, 0.089, 0.175)), tmp_path / "carton.stl", 1000.0)
    assert main(["object", "add", str(mesh), "--mass", "0.5", "--shape", "box", "--to", str(tmp_path / "mine")]) == 0
    shown = capsys.readouterr().out
    assert "carton" in shown and "38.0 89.0 175.0" in shown.replace("\n", " ") and "591.9" in shown
    assert json.loads((tmp_path / "mine" / "carton" / "object.json").read_text())["source"]["units"] == "mm"
    data = make_folder(tmp_path / "set")
    labels = [replace(make_label(free_hand()), object_id="carton"), make_label(free_hand())]
    write_native(tmp_path / "my.npz", labels, "made by tests", "MIT", MANO_NAMES)
    words = ["--baseline", "gt_pd", "--data", str(data), "--labels", str(tmp_path / "my.npz"), "pool.kind=serial",
             "eval.window_s=0.1", "--json", str(tmp_path / "r.json"), "--gif", str(tmp_path / "r.gif")]  # fmt: skip
    assert run_command("test", [*words, f"objects={tmp_path / 'mine'}"]) == 0
    result = json.loads((tmp_path / "r.json").read_text())
    assert list(result["per_object"]) == ["carton", "004_sugar_box"]
    assert list(result["data"]["added_objects"]) == ["carton"]
    assert result["data"]["inertia"] == "true"
    assert str(tmp_path) not in json.dumps(result["data"])
    # The same box, once added and once from the free set: the same grasp gives the same result.
    first, second = result["per_label"]
    assert first["interpenetration_cm3"] == pytest.approx(second["interpenetration_cm3"], abs=1e-6)
    assert first["sim_dist_mm_per_step"] == pytest.approx(second["sim_dist_mm_per_step"], abs=0.05)
    # Without its folder the object is unknown.
    capsys.readouterr()
    assert run_command("test", words) == 2
    message = capsys.readouterr().err
    assert "unknown object 'carton'" in message and "dgrasp object add MESH --name carton" in message
    assert run_command("test", [*words, f"objects={tmp_path / 'none'}"]) == 2
    assert "objects: no folder" in capsys.readouterr().err
    # In the data's own folder of objects it is found without an option.
    (tmp_path / "mine").rename(data / "objects")
    choice = resolve(load_config(None, [f"data={data}", f"labels.source={tmp_path / 'my.npz'}"]))
    assert choice.added["carton"].folder == data / "objects" / "carton"
    assert "1 of them added: carton" in choice.describe()


@pytest.mark.parametrize(
    ("overrides", "parts"),
    [
        (["engine=pybullet"], False),
        (["engine=pybullet", "physics.concave=parts"], True),
        (["engine=pybullet", "physics.concave=mesh"], False),
        (["engine=mujoco"], True),
    ],
)
def test_who_gets_parts_instead_of_triangles(
    monkeypatch: pytest.MonkeyPatch, overrides: list[str], parts: bool
) -> None:
    asked = []
    monkeypatch.setattr("dgrasp.build.load_object", lambda folder, compat, parts: asked.append((folder, compat, parts)))
    choice = SimpleNamespace(labels=SimpleNamespace(objects=["cup"]), added={"cup": StoredObject(Path("x"), "cup-1")})
    build_objects(choice, load_config(None, [*overrides, "physics.official_compat=false"]))
    assert asked == [(Path("x"), False, parts)]


def test_a_folder_adds_what_it_can(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder = tmp_path / "scans"
    save(box(), folder / "good one.obj")
    save(box(), folder / "set" / "good.ply", 1000.0)
    (folder / "bad.stl").write_bytes(b"\0" * 20)
    save(box((18.0, 9.0, 9.0)), folder / "doubt.glb")
    (folder / "notes.txt").write_text("no mesh")
    words = ["object", "add", str(folder), "--shape", "box", "--to", str(tmp_path / "to")]
    assert main(words) == 2
    shown = capsys.readouterr()
    refused = shown.err.splitlines()
    assert len(refused) == 2 and all(line.startswith("refused: ") for line in refused)
    assert "bad.stl" in refused[0] and "doubt.glb" in refused[1] and "--units" in refused[1]
    assert sorted(p.name for p in (tmp_path / "to").iterdir()) == ["good_one", "set_good"]
    assert "good_one" in shown.out and "already there, nothing computed" not in shown.out
    (folder / "bad.stl").unlink()
    (folder / "doubt.glb").unlink()
    assert main(words) == 0
    assert capsys.readouterr().out.count("already there, nothing computed") == 2


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["none.obj"], "none.obj: no such mesh file"),
        (["a.obj", "--name", "025_mug"], "is one of the 20"),
        (["a.obj", "--name", "../up"], "expected letters"),
        (["a.obj", "--overlap", "1.5"], "--overlap 1.5"),
        (["a.obj", "--mass", "-1"], "--mass -1"),
        (["a.obj", "--density", "nan"], "--density nan"),
        (["a.obj", "--units", "mm"], "the longest side is 6e-05 m in mm"),
        (["empty"], "no mesh in this folder"),
        (["twice"], "its object would be called 'a_b'"),
        (["twice", "--name", "x"], "--name: "),
        (["twice", "--center", "0", "0", "0"], "--center: "),
    ],
)
def test_bad_input_is_one_message_and_exit_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, words: list[str], said: str
) -> None:
    monkeypatch.chdir(tmp_path)
    save(box(), tmp_path / "a.obj")
    save(box(), tmp_path / "twice" / "a b.obj")
    save(box(), tmp_path / "twice" / "a_b.obj")
    (tmp_path / "empty").mkdir()
    assert main(["object", "add", *words, "--to", "to"]) == 2
    message = capsys.readouterr().err
    assert message.startswith("error: ") and said in message and "Traceback" not in message
    assert not (tmp_path / "to").exists()


def test_negative_numbers_with_an_exponent(tmp_path: Path) -> None:
    words = ["object", "add", str(save(box(), tmp_path / "a.obj")), "--to", str(tmp_path), "--shape", "box", "--mass",
             "0.5", "--inertia", "2e-4", "2e-4", "2e-4", "-1e-6", "-.5e-5", "-1E-06", "--center", "-1e-3", "-.001", "0"]
    assert main(words) == 0
    meta = json.loads((tmp_path / "a" / "object.json").read_text())
    assert meta["center_of_mass_O"] == [-1e-3, -1e-3, 0.0]
    assert meta["inertia"] == [[2e-4, -1e-6, -5e-6], [-1e-6, 2e-4, -1e-6], [-5e-6, -1e-6, 2e-4]]
