"""What ``--dry-run`` expects against what it takes: ``python tests/benchmarks/bench_duration.py [--rounds 2]``.

Twelve settings of size, preset, frames, fusion, renderer and threads between the panoramas of ``examples/street``, each
expected, then made, round after round: in the first one nothing is remembered of this machine at the beginning.
Two ratios: seconds on the clock to those that were expected, for a quiet machine; and computing, ffmpeg's included, to
the computing that is expected, which other work on the machine changes less.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from omnisyn_cli.interpolation.job import InterpolationJob
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.interpolation.planning.duration import expected_duration, shipped_table, work_of

STREET = Path(__file__).resolve().parents[2] / "examples" / "street"

CLOSE = 0.25

SETTINGS = (
    "--size 1024x512 --frames 60 --preset fast",
    "--size 1024x512 --frames 60",
    "--size 512x256 --frames 90",
    "--size 2048x1024 --frames 24 --preset fast",
    "--size 2048x1024 --frames 30",
    "--size 4096x2048 --frames 12 --preset fast",
    "--size 4096x2048 --frames 10",
    "--size 1024x512 --frames 24 --fusion network",
    "--size 1024x512 --frames 30 --threads 1",
    "--size 3072x1536 --frames 12",
)

HEADING = f"{'setting':46s} expected    took  ratio | computing    took  ratio"


@dataclass(frozen=True)
class Outcome:
    """Of one setting: seconds on the clock and of computing, expected and taken."""

    expected: float
    took: float
    work: float
    computing: float

    def __str__(self) -> str:
        return (
            f"{self.expected:8.1f} {self.took:7.1f} {self.took / self.expected:6.2f} |"
            f"{self.work:10.1f} {self.computing:7.1f} {self.computing / self.work:6.2f}"
        )


def plan_of(words: list[str], output: Path) -> InterpolationPlan:
    """The plan of a command's options."""
    options = dict(zip(words[::2], words[1::2], strict=True))
    width, height = map(int, options["--size"].split("x"))
    job = InterpolationJob(
        (STREET / "first.jpg", STREET / "second.jpg"), STREET / "poses.json", output, overwrite=True,
        frames=int(options["--frames"]), size=(height, width), preset=options.get("--preset", "balanced"),
        fusion=options.get("--fusion", "auto"), renderer=options.get("--renderer", "auto"),
        threads=int(options["--threads"]) if "--threads" in options else None,
    )  # fmt: skip
    return plan_interpolation(job)


def computing() -> float:
    """Seconds that processes which have ended have computed."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def outcome(words: list[str], output: Path) -> Outcome:
    """What is expected of a setting, then what it takes."""
    plan = plan_of(words, output)
    expected, work = expected_duration(plan), work_of(plan, shipped_table())
    if expected is None or work is None:
        raise SystemExit(f"no figures of {' '.join(words)}")
    command = [sys.executable, "-m", "omnisyn_cli", "interpolate", *map(str, plan.job.images)]
    begin, before = time.perf_counter(), computing()
    subprocess.run(
        [*command, "--poses", str(plan.job.poses), "-o", str(output), "--overwrite", "-q", *words], check=True
    )
    took, computed = time.perf_counter() - begin, computing() - before
    return Outcome(expected.seconds, took, work.start + work.pairs + work.frames, computed)


def main() -> None:
    """All settings, round after round."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=2)
    rounds = parser.parse_args().rounds
    with tempfile.TemporaryDirectory() as folder:
        os.environ["OMNISYN_CACHE_DIR"] = str(Path(folder) / "cache")
        for number in range(1, rounds + 1):
            print(f"round {number}\n{HEADING}")
            outcomes = []
            for setting in SETTINGS:
                outcomes.append(outcome(setting.split(), Path(folder) / "clip.mp4"))
                print(f"{setting:46s} {outcomes[-1]}", flush=True)
            clock = sum(abs(each.took / each.expected - 1) <= CLOSE for each in outcomes)
            work = sum(abs(each.computing / each.work - 1) <= CLOSE for each in outcomes)
            print(f"within {CLOSE:.0%}: {clock} of {len(outcomes)} on the clock, {work} of computing")


if __name__ == "__main__":
    main()
