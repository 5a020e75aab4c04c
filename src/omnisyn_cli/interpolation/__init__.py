"""From files to a video: what ``omnisyn interpolate`` does, as a library.

:func:`plan_interpolation` (:mod:`omnisyn_cli.planning`) reads and checks what can be known without decoding a
picture; :func:`run_interpolation` does the work. Nothing appears under its final name unless all of it succeeded.
"""

from omnisyn_cli.interpolation.loading import PanoramaReader
from omnisyn_cli.interpolation.run import make_estimator, run_interpolation
from omnisyn_cli.interpolation.summary import Summary
from omnisyn_cli.planning import DEPTH_METHODS, InterpolationJob, InterpolationPlan, plan_interpolation

__all__ = [
    "DEPTH_METHODS",
    "InterpolationJob",
    "InterpolationPlan",
    "PanoramaReader",
    "Summary",
    "make_estimator",
    "plan_interpolation",
    "run_interpolation",
]
