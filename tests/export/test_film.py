from __future__ import annotations

import io
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from dgrasp.errors import ConfigError
from dgrasp.export import film
from tests.eval.records import DT
from tests.export.sequences import STEPS, sequence


def blue(picture: np.ndarray) -> np.ndarray:
    """Rows of the pixels that show the object, the only blue thing."""
    r, g, b = (picture[..., k].astype(int) for k in range(3))
    return np.nonzero((b > r + 25) & (b > g + 10))[0]


def test_pictures_show_the_object_sink() -> None:
    shown = list(film.pictures(sequence(), every=3, size=(120, 90)))
    assert len(shown) == 3 and all(picture.shape == (90, 120, 3) for picture in shown)
    rows = [blue(picture) for picture in shown]
    assert all(len(r) > 20 for r in rows)
    # 6 cm further down after 6 steps; the picture is about 0.5 m high.
    assert rows[2].mean() > rows[0].mean() + 4


def test_gif_plays_at_the_sequences_speed(monkeypatch: pytest.MonkeyPatch) -> None:
    pictures = film.pictures
    monkeypatch.setattr(film, "pictures", lambda one, every: pictures(one, every, (64, 48)))
    with Image.open(io.BytesIO(film.gif(sequence()))) as image:
        assert image.n_frames == STEPS // 2
        shown = []
        for frame in range(image.n_frames):
            image.seek(frame)
            shown.append(image.info["duration"])
        # Each frame lasts two control steps of 28.86 ms. GIF rounds to hundredths of a second; errors do not add up.
        assert sum(shown) == pytest.approx(1000 * STEPS * DT, abs=5.0)


def test_mp4(tmp_path: Path) -> None:
    ffmpeg = pytest.importorskip("imageio_ffmpeg")
    path = tmp_path / "new" / "a.mp4"
    film.write_mp4(path, sequence())
    assert path.read_bytes()[4:8] == b"ftyp" and [p.name for p in path.parent.iterdir()] == ["a.mp4"]
    frames, seconds = ffmpeg.count_frames_and_secs(str(path))
    assert frames == STEPS and seconds == pytest.approx(STEPS * DT, abs=0.02)


def test_mp4_without_its_package_says_what_to_do(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    with pytest.raises(ConfigError, match=r"pip install 'dgrasp\[video\]', or export gif"):
        film.write_mp4(tmp_path / "a.mp4", sequence())
    assert list(tmp_path.iterdir()) == []
