"""What ``--dry-run`` says about memory is what a run takes."""

import subprocess
import sys
from pathlib import Path

import pytest

from omnisyn_cli.interpolation import InterpolationJob, plan_interpolation
from synthesis_samples import posed, write_hall

MEASURED = """
import sys
from pathlib import Path
from omnisyn_cli.cli import main
try:
    main(sys.argv[1:])
finally:
    status = Path("/proc/self/status").read_text().splitlines()
    print(next(line for line in status if line.startswith("VmHWM")).split()[1])
"""


@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="nobody tells the peak of memory there")
@pytest.mark.parametrize("size", [(256, 512), (1024, 2048)])
def test_the_plan_is_within_a_fifth_of_the_peak(tmp_path: Path, size: tuple[int, int]) -> None:
    """The default way, from photographs alone: as whole pictures and some rows at a time."""
    images = write_hall(tmp_path, [posed((0, 0, 0.3)), posed((0, 0, -0.3))], (256, 512), with_depth=False)
    job = InterpolationJob(tuple(images), tmp_path / "poses.json", tmp_path / "a.mp4", frames=3, size=size)
    planned = plan_interpolation(job).memory
    options = ["--poses", job.poses, "-o", job.output, "--frames", 3, "--size", f"{size[1]}x{size[0]}", "-q"]
    command = [sys.executable, "-c", MEASURED, "interpolate", *map(str, [*images, *options]), "--overwrite"]
    for _ in range(2):  # the first run may compile kernels, which takes memory of its own
        done = subprocess.run(command, check=True, capture_output=True, text=True)
    assert 0.8 < int(done.stdout.split()[-1]) * 1024 / planned < 1.2
