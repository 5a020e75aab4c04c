"""Reads many hostile files: ``python tests/fuzz/run_fuzz.py --inputs 20000``.

Every reader of files from elsewhere gets its share of broken ones (see ``fuzz_targets.py``). Allowed are reading them
and refusing them with an error of the package. Everything else is a finding: another exception, a message that does not
say what was expected, more than 5 s, more than 256 MiB, no end, the death of the process. A finding can be repeated:
``run_fuzz.py --seed S --only TARGET --index I``.
"""

import argparse
import os
import selectors
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

HERE = Path(__file__).resolve().parent

# A process that has been silent for so long hangs; importing takes its time on a busy machine.
SECONDS_WITHOUT_WORD = 120.0


@dataclass
class Report:
    counts: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)

    def add(self, index: int, result: str) -> None:
        kind, _, words = result.partition(" ")
        self.counts[kind] += 1
        if kind == "finding":
            self.findings.append(f"{index}: {words}")


def fuzz(names: Sequence[str], inputs: int, seed: int = 0, begin: int = 0) -> dict[str, Report]:
    """Read ``inputs`` broken files, shared evenly by the targets; a process that dies is replaced."""
    reports = {name: Report() for name in names}
    share = [inputs // len(names) + (at < inputs % len(names)) for at in range(len(names))]
    todo = {name: (begin, begin + count) for name, count in zip(names, share, strict=True) if count}
    while todo:
        at: tuple[str, int] | None = None
        for line in _lines_of_worker(seed, todo):
            if line.startswith("> "):
                name, _, index = line[2:].rpartition(" ")
                at = name, int(index)
            elif at is not None and not line.startswith("!"):
                reports[at[0]].add(at[1], line)
                todo = _without(todo, *at)
                at = None
            elif line.startswith("!") and at is None:
                raise RuntimeError(f"the worker ended outside of a reader: {line}")
            else:
                reports[at[0]].add(at[1], f"finding {line}")
                todo = _without(todo, *at)
    return reports


def _without(todo: dict[str, tuple[int, int]], name: str, index: int) -> dict[str, tuple[int, int]]:
    left = {**todo, name: (index + 1, todo[name][1])}
    return {name: span for name, span in left.items() if span[0] < span[1]}


def _lines_of_worker(seed: int, todo: dict[str, tuple[int, int]]) -> Iterator[str]:
    """Lines that a process prints; one that begins with ``!`` says how it ended before its time."""
    work = [f"{name}:{begin}:{end}" for name, (begin, end) in todo.items()]
    path = os.pathsep.join([*filter(None, sys.path), str(HERE.parent)])
    worker = subprocess.Popen(
        [sys.executable, str(HERE / "fuzz_worker.py"), str(seed), *work],
        stdout=subprocess.PIPE, stderr=subprocess.DEVNULL,
        env={
            **os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "ignore,error::RuntimeWarning",
        },
    )  # fmt: skip
    try:
        yield from _lines(worker)
    finally:
        worker.kill()
        worker.wait()
        if worker.stdout is not None:
            worker.stdout.close()


def _lines(worker: subprocess.Popen[bytes]) -> Iterator[str]:
    waiting, rest = selectors.DefaultSelector(), b""
    waiting.register(worker.stdout, selectors.EVENT_READ)
    while True:
        if not waiting.select(SECONDS_WITHOUT_WORD):
            yield "! no end"
            return
        data = os.read(worker.stdout.fileno(), 1 << 16)
        if not data:
            if code := worker.wait():
                yield f"! died with {code}"
            return
        *whole, rest = (rest + data).split(b"\n")
        yield from (line.decode("utf-8", "replace") for line in whole)


def main() -> int:
    from fuzz_targets import targets

    parser = argparse.ArgumentParser(description="Read hostile files.")
    parser.add_argument("--inputs", type=int, default=2000)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--begin", type=int, default=0, help="index of the first file of every target")
    parser.add_argument("--only", action="append", help="a target; repeatable")
    parser.add_argument("--index", type=int, help="only this file of the target")
    chosen = parser.parse_args()
    names = chosen.only or list(targets())
    start = time.monotonic()
    if chosen.index is not None:
        reports = fuzz(names, len(names), chosen.seed, chosen.index)
    else:
        reports = fuzz(names, chosen.inputs, chosen.seed, chosen.begin)
    total: Counter[str] = Counter()
    for name, report in reports.items():
        total += report.counts
        print(f"{name:20} accepted {report.counts['accepted']:6} refused {report.counts['refused']:6} "
              f"findings {report.counts['finding']:4}")  # fmt: skip
        for finding in report.findings[:20]:
            print(f"    {finding}")
    print(f"{'total':20} accepted {total['accepted']:6} refused {total['refused']:6} findings {total['finding']:4}   "
          f"{total.total()} files in {time.monotonic() - start:.0f} s")  # fmt: skip
    return 1 if total["finding"] else 0


if __name__ == "__main__":
    sys.exit(main())
