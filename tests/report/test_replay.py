from __future__ import annotations

import base64
import dataclasses
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from dgrasp.report import replay
from dgrasp.types import Array
from dgrasp.view.meshes import body_poses
from raisim_like.rotations import matrix_from_quaternion
from tests.eval.records import DT, standing
from tests.export.sequences import STEPS, episode, meshes
from tests.report.episodes import MUG, SUGAR, drawn, evaluated, records

VIEWER = Path(replay.__file__).with_name("viewer.js")


def row(lost_s: float | None, sim_dist: float) -> dict[str, object]:
    found: dict[str, object] = {"object": "a", "index": 0, "sim_dist_mm_per_step": sim_dist}
    return found if lost_s is None else {**found, "failure": "drop", "lost_s": lost_s}


def test_ranking_is_held_and_still_first() -> None:
    rows = [row(0.5, 1.0), row(None, 3.0), row(None, 2.0), row(2.0, 1.0), row(0.5, 0.5)]
    assert replay.ranking(rows) == [2, 1, 3, 4, 0]
    assert replay.chosen(rows) == ([0, 4], [2, 1, 3])
    assert replay.chosen(rows[:1]) == ([], [0])
    many = [row(None, float(k)) for k in range(50)]
    assert replay.chosen(many) == (list(range(49, 39, -1)), list(range(10)))


def test_moved_objects_are_ranked_by_where_they_end() -> None:
    rows = [{"object": "a", "index": 0, "mpe_m": off, "carried": off != 0.1} for off in (0.3, 0.1, 0.2)]
    assert replay.ranking(rows) == [2, 0, 1]
    assert [replay.told(row) for row in rows[:2]] == ["carried", "lost on the way"]


def numbers(text: str, dtype: str, width: int) -> Array:
    return np.frombuffer(base64.b64decode(text), dtype).reshape(-1, width).astype(float)


def packed(**changes: object) -> dict[str, object]:
    shown = [("worst", episode(**changes), {"object": SUGAR, "index": 0, "failure": "lift", "lost_s": 0.1})]
    data = replay.pack(shown, {SUGAR: meshes()})
    json.dumps(data, allow_nan=False)
    return data


def test_unpacking_gives_back_meshes_and_poses() -> None:
    data = packed()
    for mesh, given in ((data["hand"][15], meshes().hand[15]), (data["objects"][SUGAR], meshes().object)):
        vertices = np.array(mesh["lo"]) + mesh["step"] * numbers(mesh["v"], "<u2", 3)
        assert vertices == pytest.approx(given.vertices, abs=2e-6)
        assert numbers(mesh["f"], "<u2", 3).tolist() == given.faces.tolist()
    (one,) = data["replays"]
    q, t = body_poses(meshes(), episode())
    places = np.array(one["lo"]) + one["step"] * numbers(one["p"], "<u2", 3)
    assert places.reshape(STEPS, 17, 3) == pytest.approx(t, abs=1e-5)
    assert numbers(one["q"], "<i2", 4).reshape(STEPS, 17, 4) / 32767 == pytest.approx(q, abs=2e-5)
    # The palm (bit 0) and the thumb's last part (bit 15) touch from step 2 on.
    assert numbers(one["c"], "<u4", 1)[:, 0].tolist() == [0, 0] + [1 + 2**15] * 6
    assert (one["n"], one["dt"], one["start"]) == (STEPS, DT, 2.0)


def test_collision_shapes_are_packed_once_for_all_replays() -> None:
    shown = [("best", record, line) for record, line in zip(records(), evaluated().per_label, strict=True)]
    data = replay.pack(shown, drawn())
    assert len(data["replays"]) == 4 and set(data["shapes"]) == {"hand", "objects"}
    assert len(data["shapes"]["hand"]) == 16 and set(data["shapes"]["objects"]) == {SUGAR, MUG}
    shape = data["shapes"]["objects"][SUGAR]
    vertices = np.array(shape["lo"]) + shape["step"] * numbers(shape["v"], "<u2", 3)
    assert np.abs(vertices).max(axis=0) == pytest.approx([0.04, 0.05, 0.03], abs=2e-6)
    # One stored sequence without shapes: the page has none.
    lacking = {**drawn(), MUG: dataclasses.replace(drawn()[MUG], shapes=())}
    assert replay.pack(shown, lacking)["shapes"] is None


def test_a_target_is_one_more_body() -> None:
    target = np.eye(4)
    target[:3, 3] = [0.4, 0.1, 0.9]
    (one,) = packed(T_WG=standing(target, STEPS))["replays"]
    assert one["stays"] and not packed()["replays"][0]["stays"]
    assert one["bodies"] == 18 and packed()["replays"][0]["bodies"] == 17
    places = (np.array(one["lo"]) + one["step"] * numbers(one["p"], "<u2", 3)).reshape(STEPS, 18, 3)
    assert places[:, 17] == pytest.approx(np.tile([0.4, 0.1, 0.9], (STEPS, 1)), abs=1e-4)
    assert numbers(one["q"], "<i2", 4).reshape(STEPS, 18, 4)[:, 17].tolist() == [[32767.0, 0.0, 0.0, 0.0]] * STEPS


def test_long_and_broken_episodes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(replay, "MAX_FRAMES", 4)
    (one,) = packed()["replays"]
    # Steps 0, 2, 4, 6; the table is removed after step 2, which is frame 1.
    assert (one["n"], one["dt"], one["start"]) == (4, 2 * DT, 1.0)
    monkeypatch.undo()
    T_WO = episode().T_WO.copy()
    T_WO[6:, :3, 3] = np.nan
    T_WO[5, 0, 3] = 1e9
    (one,) = packed(T_WO=T_WO)["replays"]
    places = (np.array(one["lo"]) + one["step"] * numbers(one["p"], "<u2", 3)).reshape(STEPS, 17, 3)
    # A distant object is drawn 2 m from the wrist's first position (0.5); steps with NaN repeat the last finite step.
    assert places[5:, 16, 0] == pytest.approx(2.5, abs=1e-4)


def test_the_viewer_sees_what_was_packed(tmp_path: Path) -> None:
    node = shutil.which("node")
    if node is None:
        pytest.skip("no node to run the viewer's script with")
    shown = [("best", record, line) for record, line in zip(records(), evaluated().per_label, strict=True)]
    (tmp_path / "data.json").write_text(json.dumps(replay.pack(shown, drawn())))
    script = f"""
      const R = require({json.dumps(str(VIEWER))});
      const scene = R.decode(JSON.parse(require("fs").readFileSync({json.dumps(str(tmp_path / "data.json"))})));
      const r = scene.replays[1], out = {{}};
      out.poses = [0, 3, 4.5, 7].map((f) => [0, 15, 16].map((b) => Array.from(R.pose(r, b, f))));
      out.counts = [...scene.hand, scene.objects[r.object]].map((g) => g.count);
      const g = scene.objects[r.object];
      out.normals = Array.from(g.normals); out.positions = Array.from(g.positions);
      const s2 = [0, 1, 2].map((k) => scene.shapes.objects[r.object].positions.reduce((m, v, i) =>
        (i % 3 === k ? Math.max(m, v) : m), 0));
      out.shape = s2; out.shapes = scene.shapes.hand.map((g) => g.count);
      out.outline = Array.from(R.outline(scene.shapes.objects[r.object]).positions);
      out.none = R.decode({{...JSON.parse(require("fs").readFileSync({json.dumps(str(tmp_path / "data.json"))})),
        shapes: null}}).shapes;
      out.seconds = [0, 2, 7].map((f) => R.seconds(r, f));
      out.loss = R.lossFrame(r); out.held = R.lossFrame(scene.replays[0]);
      const view = R.camera({{yaw: 0.4, pitch: 0.3, zoom: 1}}, r.target, 1.5);
      const m = view.matrix, t = [...r.target, 1];
      out.middle = [0, 1, 2, 3].map((i) => [0, 1, 2, 3].reduce((s, k) => s + m[4 * k + i] * t[k], 0));
      out.eye = view.eye;
      const s = R.shadow(0.25), p = [0.1, 0.2, 0.6, 1];
      out.shadow = [0, 1, 2, 3].map((i) => [0, 1, 2, 3].reduce((a, k) => a + s[4 * k + i] * p[k], 0));
      out.hash = R.readHash("#t=0.5&yaw=-30&x=&y=a"); out.target = r.target;
      console.log(JSON.stringify(out));"""
    done = subprocess.run([node, "-e", script], capture_output=True, text=True, check=True)
    out = json.loads(done.stdout)
    q, t = body_poses(meshes(), records()[1])
    for place, frame in enumerate((0, 3, None, 7)):
        for k, body in enumerate((0, 15, 16)):
            got = np.array(out["poses"][place][k]).reshape(4, 4).T
            if frame is None:
                assert got[:3, 3] == pytest.approx((t[4, body] + t[5, body]) / 2, abs=1e-5)
                continue
            assert got[:3, 3] == pytest.approx(t[frame, body], abs=1e-5)
            assert got[:3, :3] == pytest.approx(matrix_from_quaternion(q[frame, body]), abs=1e-4)
    assert out["counts"] == [36] + [0] * 14 + [36, 36]
    # A box has the normals of its sides, however its corners are shared.
    normals, positions = (np.array(out[name]).reshape(-1, 3) for name in ("normals", "positions"))
    assert np.abs(normals).max(axis=1) == pytest.approx(1.0, abs=1e-5)
    assert ((normals * positions).sum(axis=1) > 0).all()
    # The collision shape of the sugar box, and its twelve edges; the diagonals of its sides are no edges.
    assert out["shape"] == pytest.approx([0.04, 0.05, 0.03], abs=2e-6) and out["none"] is None
    assert out["shapes"] == [36] + [0] * 14 + [36]
    ends = np.array(out["outline"]).reshape(-1, 2, 3)
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    assert np.sort(lengths) == pytest.approx([0.06] * 4 + [0.08] * 4 + [0.10] * 4, abs=1e-5)
    assert out["seconds"] == pytest.approx([-2 * DT, 0.0, 5 * DT])
    # The object is lost in step 6, the last step with a touch before it lands.
    assert out["loss"] == pytest.approx(6.0) and out["held"] is None
    # The point that the camera turns about is at the centre of the picture and 0.7 m away.
    assert out["middle"][:2] == pytest.approx([0.0, 0.0], abs=1e-5)
    assert np.linalg.norm(np.array(out["eye"]) - out["target"]) == pytest.approx(0.7, abs=1e-5)
    # The point is 0.35 m above the plane; the light comes from (0.28, -0.22, 1).
    assert out["shadow"][:3] == pytest.approx([0.1 - 0.28 * 0.35, 0.2 + 0.22 * 0.35, 0.25], abs=1e-6)
    assert out["hash"] == {"t": 0.5, "yaw": -30}
