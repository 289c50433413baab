"""Whether a method holds the same objects on two engines: `python -m benchmarks.agreement warp mujoco -- OPTIONS`.

OPTIONS are those of test.py. Each engine tests the same labels in a process of its own. Prints how many labels each
holds, the share of labels on which both agree (held or lost), the labels on which they differ, and the seconds.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

Label = tuple[str, int]


def held(result: dict[str, Any]) -> dict[Label, bool]:
    """Which labels a result says are held, by object and number."""
    return {(row["object"], row["index"]): bool(row["success"]) for row in result["per_label"]}


def compare(first: dict[Label, bool], second: dict[Label, bool]) -> tuple[float, list[Label]]:
    """The share of the labels on which both agree, and the labels on which they differ."""
    if first.keys() != second.keys():
        raise ValueError("the two results are of different labels")
    differ = sorted(label for label, result in first.items() if second[label] != result)
    return 1.0 - len(differ) / len(first), differ


def main() -> None:
    """Test on both engines and print the comparison."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("engines", nargs=2)
    parser.add_argument("options", nargs="+", help="after --: options of test.py, without --engine and --json")
    arguments = parser.parse_args()
    results = []
    with tempfile.TemporaryDirectory() as folder:
        for engine in arguments.engines:
            file = Path(folder) / f"{engine}.json"
            words = [*arguments.options, "--engine", engine, "--json", str(file)]
            subprocess.run([sys.executable, "-m", "dgrasp", "test", *words], check=True, stdout=subprocess.DEVNULL)
            results.append(json.loads(file.read_text(encoding="utf-8")))
    for engine, result in zip(arguments.engines, results, strict=True):
        labels = held(result)
        print(f"{engine}: {sum(labels.values())} of {len(labels)} labels held, {result['cost']['wall_s']:.0f} s")
    share, differ = compare(*(held(result) for result in results))
    print(f"agreement {share:.3f}; different: {', '.join(f'{name} {index}' for name, index in differ) or 'none'}")


if __name__ == "__main__":
    main()
