"""The recorded quality: ``python tests/benchmarks/regression.py`` measures it anew and writes the table.

The table holds the mean WS-PSNR of the true frames of two small scenes of the standard set, by scene and method.
``test_regression.py`` measures them again and fails where one has dropped.
"""

import json
import sys
import tempfile
from pathlib import Path
from statistics import fmean

from omnisyn_cli import __version__
from omnisyn_cli.evaluation.engine import EvaluationJob, evaluate, plan_evaluation
from omnisyn_cli.evaluation.scene_files import PANORAMA_NAMES, SUPERSAMPLE, write_scene
from omnisyn_cli.scenes import generate_scene
from omnisyn_cli.scenes.paths import suite_scenes

TABLE = Path(__file__).with_name("regression.json")
SCENES = ("street-9000001-2m", "room-9000001-1m")
SIZE = (256, 512)
METHODS = ("omnisyn-balanced", "oracle-depth", "crossfade")
TOLERANCE = 0.3  # dB that a figure may drop by.
Scores = dict[str, dict[str, float]]  # WS-PSNR in dB by scene and method.


def write_scenes(folder: Path) -> None:
    for walk in suite_scenes():
        if walk.name in SCENES:
            (folder / walk.name).mkdir(parents=True)
            scene = generate_scene(walk.kind, walk.seed)
            write_scene(folder / walk.name, scene, walk.path, PANORAMA_NAMES, SIZE, SUPERSAMPLE)


def measure(folder: Path) -> Scores:
    """Make the scenes below ``folder`` and let every method try them."""
    write_scenes(folder / "scenes")
    job = EvaluationJob(folder / "scenes", folder / "report", ",".join(METHODS), pictures=False)
    scores: Scores = {scene: {} for scene in SCENES}
    for record in evaluate(plan_evaluation(job), has_report=False):
        if record.status != "done":
            raise RuntimeError(f"{record.scene}: expected {record.method} to work, got '{record.reason}'")
        scores[record.scene][record.method] = round(fmean(frame.scores["ws_psnr"] for frame in record.frames), 3)
    return scores


def drops(recorded: Scores, measured: Scores, tolerance: float) -> list[str]:
    """Every figure that has dropped by more than ``tolerance`` dB, or is not there any more, in words."""
    return [
        f"{scene}: {method} had {score:.2f} dB and has {found:.2f} dB"
        for scene, methods in recorded.items()
        for method, score in methods.items()
        if not (found := measured.get(scene, {}).get(method, float("nan"))) >= score - tolerance
    ]


def main() -> None:
    before = json.loads(TABLE.read_text())["ws_psnr"] if TABLE.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        scores = measure(Path(folder))
    content = {"version": __version__, "size": list(SIZE), "tolerance_db": TOLERANCE, "ws_psnr": scores}
    TABLE.write_text(json.dumps(content, indent=2) + "\n")
    for scene, methods in scores.items():
        for method, score in methods.items():
            print(f"{scene:20} {method:18} {before.get(scene, {}).get(method, float('nan')):7.2f} -> {score:7.2f} dB")


if __name__ == "__main__":
    sys.exit(main())
