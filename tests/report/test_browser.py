"""The report in a real browser: headless Chromium opens it from disk, finds the table, and its replay moves and turns.

Looked for: chromium, chromium-browser, google-chrome, chrome on the path, then the browsers that playwright keeps.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dgrasp.types import Array
from tests.report.episodes import page

FLAGS = (
    "--headless", "--no-sandbox", "--disable-quic", "--no-first-run", "--disable-background-networking",
    "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage", "--hide-scrollbars",
    # WebGL without a graphics card.
    "--use-angle=swiftshader", "--enable-unsafe-swiftshader", "--ignore-gpu-blocklist",
    "--force-device-scale-factor=1", "--virtual-time-budget=3000",
)  # fmt: skip


def chromium() -> str | None:
    """The path of a Chromium browser, or None."""
    for name in ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome"):
        if found := shutil.which(name):
            return found
    kept = Path(os.environ.get("PLAYWRIGHT_BROWSERS_PATH", Path.home() / ".cache" / "ms-playwright"))
    built = sorted(p for p in kept.glob("chromium*/*/*") if p.name in ("chrome", "headless_shell", "Chromium"))
    return str(built[-1]) if built else None


class Browser:
    """Opens the report in a new browser process for each question."""

    def __init__(self, binary: str, folder: Path) -> None:
        self.binary, self.folder, self.looks = binary, folder, 0
        self.file = folder / "report.html"
        self.file.write_text(page(), encoding="utf-8")

    def _run(self, *words: str) -> str:
        self.looks += 1
        profile = self.folder / f"profile{self.looks}"
        command = [self.binary, *FLAGS, f"--user-data-dir={profile}", *words]
        done = subprocess.run(command, capture_output=True, text=True, timeout=180)
        assert done.returncode == 0, done.stderr[-2000:]
        return done.stdout

    def dom(self, view: str, script: str = "") -> str:
        """The page's elements after its scripts, and another one, have run."""
        file = self.folder / "scripted.html"
        file.write_text(page().replace("</body>", f"<script>{script}</script></body>"), encoding="utf-8")
        return self._run("--dump-dom", f"{file.as_uri()}#{view}")

    def pictures(self, *views: str) -> list[Array]:
        """The middle of the replay in full-window mode, (300, 500, 3) each, without text and controls.

        One browser shows the report once for each view, one below the other.
        """
        file, frames = self.folder / "shot.png", self.folder / "frames.html"
        file.unlink(missing_ok=True)
        frames.write_text("<body style='margin: 0'>" + "".join(
            f"<iframe src='{self.file.as_uri()}#{view}&full=1' style='display: block; border: 0' width=900 height=700>"
            "</iframe>" for view in views), encoding="utf-8")  # fmt: skip
        self._run(f"--window-size=900,{700 * len(views)}", f"--screenshot={file}", frames.as_uri())
        with Image.open(file) as image:
            whole = np.asarray(image.convert("RGB"), dtype=int)
        return [whole[700 * i + 150 : 700 * i + 450, 200:700] for i in range(len(views))]


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Browser:
    found = chromium()
    if found is None:
        pytest.skip("no Chromium here (looked for chromium, google-chrome and playwright's); install one to run this")
    return Browser(found, tmp_path_factory.mktemp("browser"))


def test_the_table_is_there_and_the_viewer_runs(browser: Browser) -> None:
    text = browser.dom("t=0.5")
    assert 'data-viewer="ready"' in text
    table = re.search(r'<table id="results">.*?</table>', text, re.S)
    assert table is not None and "025_mug" in table[0] and "mean over objects" in table[0]
    # Half of eight frames: 3.5 of 0 to 7.
    assert 'data-frame="3.50"' in text
    assert "lost (lift)" in browser.dom("t=1&replay=0")


def test_the_replay_moves_and_turns(browser: Browser) -> None:
    start, again, end, turned = browser.pictures(
        "replay=2&t=0&zoom=2", "replay=2&t=0&zoom=2", "replay=2&t=1&zoom=2", "replay=2&t=0&zoom=2&yaw=170")
    assert np.abs(start - again).max() <= 2
    # The hand turns by two radians and the object sinks by 7 cm, so a good part of the picture changes.
    for other in (end, turned):
        assert (np.abs(start - other).max(axis=2) > 30).mean() > 0.03
    assert blue(start) > 0.01


def blue(picture: Array) -> float:
    """The share of the picture that shows the object, the only blue thing."""
    return float(((picture[..., 2] - picture[..., 0]) > 40).mean())


def test_the_collision_shapes_take_the_place_of_the_surfaces(browser: Browser) -> None:
    # Replay 2 shows a box that collides as one of twice its width, seen here from the side.
    surfaces, shapes = browser.pictures(
        *(f"replay=2&t=0&zoom=1.5&pitch=0&yaw=90&shapes={on}" for on in (0, 1)))
    assert blue(shapes) > 1.5 * blue(surfaces) > 0.0


def test_the_key_s_and_the_box_switch_the_collision_shapes(browser: Browser) -> None:
    script = """
      const box = document.getElementById("shapes"), log = [];
      const note = () => log.push(Number(box.checked), Number(!document.getElementById("ghost-key").hidden));
      const press = (how) => document.getElementById("stage").dispatchEvent(
        new KeyboardEvent("keydown", { key: "s", bubbles: true, ...how }));
      note(); press({}); note(); press({ ctrlKey: true }); note(); press({}); note(); box.click(); note();
      document.documentElement.dataset.log = log.join("");"""
    # On by the address; off by the key; with control the key is the browser's; on by the key; off by the box.
    assert 'data-log="1100001100"' in browser.dom("shapes=1", script)
