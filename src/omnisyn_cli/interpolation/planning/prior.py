"""What a depth network of the user's takes, as it was measured on this machine, and which of its answers are kept."""

from dataclasses import replace
from pathlib import Path
from typing import TypeVar

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.interpolation.plan import TourPlan
from omnisyn_cli.interpolation.planning.memory import PriorCost
from omnisyn_cli.io import read_panorama
from omnisyn_cli.runtime.monocular_session import MonocularSession, NetworkKind
from omnisyn_cli.runtime.session import open_session

P = TypeVar("P", bound=TourPlan)


def with_prior_cost(plan: P, *, is_measured: bool) -> P:
    """The plan with what its depth prior takes, if that is a network of the user's.

    If ``is_measured``, one that was never run here is asked about one picture, and panoramas are read to see which
    answers are kept. Else only its size is looked at: a run reads panoramas once. InputError: it is no such network.
    """
    depth, path = plan.config.depth, Path(str(plan.config.depth.prior))
    if not depth.has_own_prior:
        return plan
    if not is_measured:
        return replace(plan, prior_cost=PriorCost(path.stat().st_size if path.is_file() else 0, None))
    session = open_session(path, device=plan.config.device, threads=plan.job.threads, keeps_memory=False)
    network = MonocularSession(session, path, NetworkKind.from_words(depth.prior_kind))
    cost = network.try_out()
    # OpenCV takes a while to import and is needed for pictures only.
    from omnisyn_cli.interpolation.loading import Loader
    from omnisyn_cli.stereo.monocular_answer import pictures_of

    views = Loader(replace(plan, job=replace(plan.job, nadir=0.0)), Stopwatch(), read_panorama)  # masks do not matter
    pictures = (each for view in views for each in pictures_of(view, network.size, network.is_panoramic))
    are_kept = [network.answer_file(picture).exists() for picture in pictures]
    seconds, kept = round(cost.seconds * are_kept.count(False), 1), are_kept.count(True)
    takes = f"at most {seconds:g} s and {cost.memory / 1e9:.1f} GB"
    words = f"depth prior: {takes} for {len(are_kept)} pictures, {kept} of them with kept answers"
    return replace(plan, prior_cost=PriorCost(cost.memory, seconds, words))
