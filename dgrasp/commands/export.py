"""`dgrasp export`: convert stored sequences to plain arrays, animations or videos."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from dgrasp.errors import ConfigError
from dgrasp.files.atomic import write_atomic

if TYPE_CHECKING:
    from dgrasp.export.sequence import StoredSequence

FORMATS = ("npz", "glb", "gif", "mp4")

HELP = """\
Export evaluated sequences that `test --records DIR` has stored.

  npz   joint angles, wrist, object, contacts and forces of each step; MANO parameters if the hand was made from MANO
  glb   an animation of hand, object and table for Blender, browsers and other glTF viewers
  gif   a video
  mp4   a video; needs imageio-ffmpeg (pip install 'dgrasp[video]')

examples:
  dgrasp test --baseline gt_pd --records sequences
  dgrasp export sequences/004_sugar_box_0003.npz --format glb --out sugar_box.glb
  dgrasp export sequences --format npz --mano MANO_RIGHT.pkl --out arrays
"""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of `export`."""
    parser.add_argument("source", type=Path, metavar="FILE|DIR", help="a stored sequence, or a folder of them")
    parser.add_argument("--format", choices=FORMATS, help="what to write (default: from the suffix of --out)")
    parser.add_argument("--out", type=Path, required=True, metavar="FILE|DIR",
                        help="a new file, or a folder if the source is one")
    parser.add_argument("--shapes", action="store_true",
                        help="glb, gif, mp4: draw the collision shapes in place of the surfaces")
    parser.add_argument("--mano", type=Path, metavar="FILE",
                        help="the MANO file that the hand was made from; adds MANO's translation to npz")


def main(arguments: argparse.Namespace) -> int:
    """Export one sequence or all of a folder; returns the exit code."""
    from dgrasp.export.sequence import read_sequence, sequence_files

    files = sequence_files(arguments.source)
    kind = arguments.format or arguments.out.suffix[1:].lower()
    if kind not in FORMATS:
        raise ConfigError(f"--out {arguments.out}: no format in its name; expected --format {'|'.join(FORMATS)}")
    if arguments.mano is not None and kind != "npz":
        raise ConfigError(f"--mano adds MANO's translation to npz; {kind} cannot hold it; leave out --mano")
    if arguments.shapes and kind == "npz":
        raise ConfigError("--shapes is for glb, gif and mp4; npz has no meshes to draw; leave out --shapes")
    many = arguments.source.is_dir()
    targets = [arguments.out / f"{file.stem}.{kind}" if many else arguments.out for file in files]
    there = [target for target in targets if target.exists()]
    if there:
        raise ConfigError(f"{there[0]} exists already; choose another --out")
    for file, target in zip(files, targets, strict=True):
        sequence = read_sequence(file, arguments.shapes)
        if arguments.shapes:
            sequence = replace(sequence, meshes=sequence.meshes.colliding())
        _write(kind, target, sequence, arguments.mano)
        print(f"wrote {target}{_said(kind, sequence, arguments.mano)}", flush=True)
    return 0


def _write(kind: str, path: Path, sequence: StoredSequence, mano: Path | None) -> None:
    from dgrasp.export import arrays, film, glb

    if kind == "mp4":
        film.write_mp4(path, sequence)
    elif kind == "gif":
        write_atomic(path, film.gif(sequence))
    else:
        write_atomic(path, glb.glb_bytes(sequence) if kind == "glb" else arrays.npz_bytes(sequence, mano))


def _said(kind: str, sequence: StoredSequence, mano: Path | None) -> str:
    """A remark on the MANO parameters of an npz, for the line that names the file; empty for other formats."""
    if kind != "npz":
        return ""
    if sequence.about["mano"] is None:
        from dgrasp.export import arrays

        return f"; MANO's parameters: {arrays.mano_note(sequence)}"
    if mano is None and "root_joint" not in sequence.about["mano"]:
        return "; without mano_transl, which needs MANO's root joint: add --mano FILE"
    return ""
