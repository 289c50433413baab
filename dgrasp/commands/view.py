"""`dgrasp view`: show stored sequences as a page of replays in the browser."""

from __future__ import annotations

import argparse
import webbrowser
from html import escape
from pathlib import Path

from dgrasp.config.sections import INERTIA
from dgrasp.errors import ConfigError
from dgrasp.files.atomic import write_atomic
from dgrasp.files.outputs import check_outputs

HELP = """\
View sequences that `test --records DIR` has stored. Writes one HTML page that works offline; its replays can be
rotated and scrubbed.

examples:
  dgrasp test --run pretrained --records sequences
  dgrasp view sequences                                      writes sequences/view.html and opens it
  dgrasp view sequences --shapes                             begins with the collision shapes
  dgrasp view sequences/004_sugar_box_0003.npz --out box.html --no-browser
"""
MOST = 40
"""Most replays on a page; each adds about 50 kB."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of `view`."""
    parser.add_argument("source", type=Path, metavar="FILE|DIR", help="a stored sequence, or a folder of them")
    parser.add_argument("--out", type=Path, metavar="FILE.html",
                        help="the page to write (default: view.html beside the sequences)")
    parser.add_argument("--shapes", action="store_true",
                        help="begin with the collision shapes in place of the surfaces; the page can switch")
    parser.add_argument("--no-browser", action="store_true", help="write the page without opening it")


def main(arguments: argparse.Namespace) -> int:
    """Write the page and open it; returns the exit code."""
    from dgrasp.export.sequence import read_sequence, sequence_files
    from dgrasp.report import replay
    from dgrasp.report.page import document, replays_section

    files = sequence_files(arguments.source)
    out = arguments.out or (arguments.source if arguments.source.is_dir() else arguments.source.parent) / "view.html"
    if out.suffix.lower() not in (".html", ".htm"):
        raise ConfigError(f"--out {out}: expected the name of an .html file")
    check_outputs({"--out": out}, files)
    if len(files) > MOST:
        print(f"{len(files)} sequences: the page shows 1 of every {-(-len(files) // MOST)}")
        files = files[:: -(-len(files) // MOST)]
    sequences = [read_sequence(file, arguments.shapes) for file in files]
    rows = [{"object": s.record.label.object_id, "index": s.record.label.index, **s.about["row"]} for s in sequences]
    shown = [("sequences", s.record, row) for s, row in zip(sequences, rows, strict=True)]
    data = replay.pack(shown, {s.record.label.object_id: s.meshes for s in sequences})
    name = arguments.source.name or "sequences"
    first = sequences[0].about
    inertia = INERTIA.get(first["data"].get("inertia", ""))
    lead = f'<p class="lead">The objects have {escape(inertia)}.</p>' if inertia else ""
    head = (f'<header><p class="over">D-Grasp sequences</p><h1>{escape(name)} <span>{escape(first["method"])} on '
            f'{escape(first["engine"])}</span></h1>{lead}</header>\n')
    write_atomic(out, document(name, [head, replays_section(shown, arguments.shapes)], data))
    print(f"wrote {out}")
    if not arguments.no_browser and not webbrowser.open(out.absolute().as_uri()):
        print("no browser found; open the page on a machine that has one")
    return 0
