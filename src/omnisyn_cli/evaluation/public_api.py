"""The verbs of ``import omnisyn_cli`` that compare; the others are in :mod:`omnisyn_cli.interpolation.api`."""

from contextlib import nullcontext
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from omnisyn_cli.evaluation import engine
from omnisyn_cli.evaluation.measure import frame_scores
from omnisyn_cli.evaluation.results import UnitRecord
from omnisyn_cli.io.outputs import scratch_folder

__all__ = ["evaluate", "score"]


def evaluate(
    dataset: Path | str, methods: str = "usual", report: Path | str | None = None, **options: Any
) -> list[UnitRecord]:
    """Compare methods with true frames and true depth, as ``omnisyn eval`` does; a record for each on every pair.

    ``methods`` are ``usual``, ``all`` or names separated by commas. ``report`` is a folder for results and pictures;
    None keeps nothing. ``options`` are those of :class:`omnisyn_cli.evaluation.engine.EvaluationJob`. OmnisynError: no
    scenes, no such method, or a folder that cannot be written.
    """
    is_kept = report is not None
    with scratch_folder() if report is None else nullcontext(Path(report)) as folder:
        job = engine.EvaluationJob(Path(dataset), folder, methods, **{"pictures": is_kept, **options})
        return engine.evaluate(engine.plan_evaluation(job), has_report=is_kept)


def score(image: Float[np.ndarray, "height width 3"], truth: Float[np.ndarray, "height width 3"]) -> dict[str, float]:
    """How near a frame is to the true one: ``ws_psnr`` (dB), ``ws_ssim`` and others."""
    return frame_scores(np.asarray(np.clip(image, 0.0, 1.0)), truth)
