"""The command line, such as `dgrasp train` and `dgrasp test`; train.py and test.py are shortcuts for these two."""

from __future__ import annotations

import argparse
import difflib
import os
import re
import sys
from collections.abc import Sequence
from importlib import import_module
from typing import Any, NoReturn

from dgrasp.errors import DGraspError
from dgrasp.rl.run.interrupts import Interrupted, interruptible
from dgrasp.version import __version__

EXIT_BAD_INPUT, EXIT_INTERRUPTED = 2, 130
COMMANDS = {
    "train": "dgrasp.commands.train",
    "test": "dgrasp.commands.test",
    "demo": "dgrasp.commands.demo",
    "grasp": "dgrasp.commands.grasp",
    "runs": "dgrasp.commands.runs",
    "publish": "dgrasp.commands.publish",
    "export": "dgrasp.commands.export",
    "view": "dgrasp.commands.view",
    "hand build": "dgrasp.commands.hand_build",
    "hand report": "dgrasp.commands.hand_report",
    "object add": "dgrasp.commands.object_add",
    "labels import dexycb": "dgrasp.commands.labels_import.dexycb",
    "labels import ho3d": "dgrasp.commands.labels_import.ho3d",
    "labels import mano": "dgrasp.commands.labels_import.mano",
    "labels make": "dgrasp.commands.labels_make",
    "labels check": "dgrasp.commands.labels_check",
}
"""Command -> its module, which defines `HELP`, `add_arguments` and `main`."""
_SHORT = {
    "hand build": "make a physics hand from a MANO file or the free skin",
    "hand report": "print the figures of a hand, or of two side by side",
    "object add": "make objects for the physics from mesh files",
    "labels import dexycb": "make labels from DexYCB's recordings",
    "labels import ho3d": "make labels from HO3D's annotations",
    "labels import mano": "make labels from a table of MANO parameters",
    "labels make": "synthesise grasps for a hand and objects",
    "labels check": "measure the labels of a file and say what is wrong with them",
}
"""What the commands of several words do, for `dgrasp hand --help` and the like."""

_USAGE = """\
usage: dgrasp COMMAND ...      (dgrasp COMMAND --help explains a command)

Dynamic grasps from static grasp labels, on open physics (D-Grasp, CVPR 2022).

commands:
  train    train a grasping policy
  test     evaluate a policy or a baseline
  demo     test the shipped policy and train briefly on the free set, with replays
  grasp    from a mesh to ranked grasps in the simulator: dgrasp grasp cup.stl --units mm
  runs     list training runs, or compare two
  publish  write a trained policy as one small file
  view     show stored sequences as a page of replays
  export   convert stored sequences to arrays, GLB animations, GIF or mp4
  hand     build: make a physics hand from a MANO file or the free skin; report: print or compare hands
  object   add: make objects for the physics from mesh files
  labels   import: convert DexYCB, HO3D or MANO parameters to labels; make: synthesise grasps; check: find problems in
           a label file
"""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code. Wrong use and bad input give one message on stderr and exit code 2."""
    if sys.version_info < (3, 10):  # noqa: UP036 (pip checks this, but a checkout's train.py runs without pip)
        found = ".".join(map(str, sys.version_info[:2]))
        print(f"dgrasp needs Python 3.10 or newer; this is {found}", file=sys.stderr)
        return EXIT_BAD_INPUT
    words = list(sys.argv[1:] if arguments is None else arguments)
    if not words or words[0] in ("-h", "--help"):
        print(_USAGE, end="", file=sys.stdout if words else sys.stderr)
        return 0 if words else EXIT_BAD_INPUT
    if words[0] == "--version":
        print(f"dgrasp {__version__}")
        return 0
    # "hand build" is one command of two words; `dgrasp hand` alone is an error that lists the commands of `hand`.
    name = next((name for name in COMMANDS if words[: name.count(" ") + 1] == name.split()), None)
    if name is None:
        first = next((words[:n] for n in (2, 1) if any(c.split()[:n] == words[:n] for c in COMMANDS)), [])
        inner = [command for command in COMMANDS if first and command.split()[: len(first)] == first]
        if inner and words[len(first) : len(first) + 1] in (["-h"], ["--help"]):
            print(f"usage: dgrasp {' '.join(first)} COMMAND ...      (COMMAND --help explains a command)\n\ncommands:")
            print("\n".join(f"  {command:<{max(map(len, inner))}}  {_SHORT[command]}" for command in inner))
            return 0
        print(f"error: {_unknown(words, len(first), inner)}", file=sys.stderr)
        return EXIT_BAD_INPUT
    return run_command(name, words[name.count(" ") + 1 :], prog=f"dgrasp {name}")


def _unknown(words: Sequence[str], known: int, inner: Sequence[str]) -> str:
    """What is wrong with words that name no command. inner: the commands that begin with the first `known` of them."""
    if known and len(words) == known:
        return f"{' '.join(words)}: expected one of the commands {', '.join(inner)}"
    offered = list(inner or COMMANDS)
    given = [" ".join(words[:n]) for n in (3, 2, 1) if n <= len(words)]
    close = [found for text in given for found in difflib.get_close_matches(text, offered, 1)]
    if not close:
        # A single word of a longer command: `dgrasp lables` means its first word, `dgrasp mkae` all of it.
        whole = {word: name for name in reversed(offered) for word in name.split()}
        whole |= {name.split()[known]: " ".join(name.split()[: known + 1]) for name in offered}
        near = [difflib.get_close_matches(word, [*whole], 1) for word in words[known : known + 1]]
        close = [whole[found] for matches in near for found in matches]
    hint = f"did you mean {close[0]!r}?" if close else f"expected one of {', '.join(offered)}"
    return f"unknown command {' '.join(words[: known + 1])!r}; {hint}"


class _Parser(argparse.ArgumentParser):
    """Says what is wrong with the options in one line, in place of the whole usage. Takes numbers such as -1e-5."""

    def __init__(self, **options: Any) -> None:
        super().__init__(**options)
        # argparse takes numbers with an exponent for options.
        self._negative_number_matcher = re.compile(r"-(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?$")

    def error(self, message: str) -> NoReturn:
        given = re.match("unrecognized arguments: (--[^ =]+)", message)
        close = difflib.get_close_matches(given[1], self._option_string_actions, 2, 0.7) if given else []
        hint = f"did you mean {' or '.join(sorted(close))}? " if close else ""
        self.exit(EXIT_BAD_INPUT, f"error: {message}; {hint}{self.prog} --help lists the options\n")


def run_command(name: str, arguments: Sequence[str], prog: str | None = None) -> int:
    """Run one command with its arguments; returns the exit code. train.py and test.py call this.

    SIGTERM ends a command like Ctrl-C: it stops its processes and frees their shared memory on the way out.
    """
    _open_streams()
    try:
        with interruptible():
            return _run(name, arguments, prog)
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return EXIT_INTERRUPTED


def _run(name: str, arguments: Sequence[str], prog: str | None) -> int:
    """Run one command; its errors become messages and exit codes."""
    try:
        module = import_module(COMMANDS[name])
        parser = _Parser(prog=prog, description=module.HELP, formatter_class=argparse.RawDescriptionHelpFormatter)
        module.add_arguments(parser)
        return int(module.main(parser.parse_intermixed_args(arguments)))
    except DGraspError as error:
        print(f"error: {error}", file=sys.stderr)
        return EXIT_BAD_INPUT
    except Interrupted as stop:
        print(str(stop), file=sys.stderr)
        return 0 if stop.preempted else EXIT_INTERRUPTED
    except OSError as error:
        # The path is not accessible or too long. An OSError without a file name is a bug, so it is raised.
        if error.filename is None:
            raise
        print(f"error: {error.filename}: {error.strerror}", file=sys.stderr)
        return EXIT_BAD_INPUT


def _open_streams() -> None:
    """Put the null device where stdin, stdout or stderr is closed, so that no other file gets its number."""
    for number in (0, 1, 2):
        try:
            os.fstat(number)
        except OSError:
            os.set_inheritable(os.open(os.devnull, os.O_RDWR), True)
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 (open until the end)


if __name__ == "__main__":
    sys.exit(main())
