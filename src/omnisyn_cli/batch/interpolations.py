"""The work function of ``omnisyn batch``: one line of a manifest becomes one interpolation."""

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from omnisyn_cli.batch.folder import attempt_folder, measure, pack, publish, workshop_is_seen
from omnisyn_cli.batch.manifest import BatchJob
from omnisyn_cli.batch.provenance import digest_of_network, sources
from omnisyn_cli.batch.reuse import DepthMemory, PanoramaMemory, Recent
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.synthesis.making import make_estimator
from omnisyn_cli.synthesis.recipe import OMNISYN

MOST_ESTIMATORS = 4
"""Kept at a time by a worker; jobs that want depth found in more ways than that load networks again."""


@dataclass(frozen=True)
class Settings:
    """What all jobs of a run have in common.

    Attributes:
        folder: of the batch, absolute.
        token: of the batch's workshop, see :func:`~omnisyn_cli.batch.folder.workshop_is_seen`.
        threads: of each interpolation.
    """

    folder: Path
    token: str
    threads: int


def make_interpolator(settings: Settings) -> Callable[[BatchJob], dict[str, Any]]:
    """The work function for a worker."""
    return _Interpolator(settings)


class _Interpolator:
    def __init__(self, settings: Settings) -> None:
        self._settings = settings
        self._panoramas = PanoramaMemory()
        self._estimators = Recent[DepthMemory](MOST_ESTIMATORS)

    def __call__(self, job: BatchJob) -> dict[str, Any]:
        """Make the outputs of a job; what there is to say about it, and the files if they could not be put in place."""
        begin, made_of, folder = time.perf_counter(), sources(job), self._settings.folder
        is_shared = workshop_is_seen(folder, self._settings.token)
        with attempt_folder(folder if is_shared else None) as attempt:
            for place in job.places:
                (attempt / place).parent.mkdir(parents=True, exist_ok=True)
            made = self._interpolate(job, attempt, made_of)
            outputs = measure(attempt, job.places)
            files = None if is_shared else pack(attempt, job.places)
            if is_shared:
                publish(attempt, folder, job.places)
        seconds = round(time.perf_counter() - begin, 3)
        return {"seconds": seconds, "outputs": outputs, **made, "sources": made_of, "files": files}

    def _interpolate(self, job: BatchJob, attempt: Path, made_of: Mapping[str, Any]) -> dict[str, Any]:
        plan = plan_interpolation(job.interpolation(attempt, self._settings.threads))
        finds_depth = plan.recipe.depth.kind != "file" and plan.recipe.method == OMNISYN
        memory = self._memory(plan, made_of) if finds_depth else None
        decoded, found = self._panoramas.decoded, memory.found if memory else 0
        summary = run_interpolation(plan, read=self._panoramas, estimator=memory).describe()
        return {
            "panoramas_decoded": self._panoramas.decoded - decoded,
            "pairs_matched": memory.found - found if memory else 0,
            "summary": {key: value for key, value in summary.items() if key not in ("inputs", "output")},
        }

    def _memory(self, plan: InterpolationPlan, made_of: Mapping[str, Any]) -> DepthMemory:
        """The estimator that jobs with the same wishes for depth share; a network is loaded once, until it changes."""
        source, device = plan.recipe.depth, plan.recipe.device
        key = (source, device, None if source.model is None else digest_of_network(source.model, made_of))
        return self._estimators.get(
            key, lambda: DepthMemory(make_estimator(source, device=device, threads=plan.job.threads))
        )
