"""What is going to be done: a user's wishes, checked against the files, before any picture is decoded.

Whatever can be refused is refused here, so that nothing fails after minutes of work that could have been known before.
"""

from omnisyn_cli.planning.checks import check_choices
from omnisyn_cli.planning.choices import networks_of
from omnisyn_cli.planning.job import (
    DEPTH_METHODS,
    FALLBACKS,
    POSES_FROM_PICTURES,
    RENDERER_CHOICES,
    RENDERERS,
    InterpolationJob,
    depth_name,
    is_rounded,
    sample_types,
    targets,
)
from omnisyn_cli.planning.on_gpu import check_device
from omnisyn_cli.planning.plan import (
    SECONDS_PER_PAIR,
    InterpolationPlan,
    frame_count,
    plan_interpolation,
    with_preset,
)

__all__ = [
    "DEPTH_METHODS",
    "FALLBACKS",
    "POSES_FROM_PICTURES",
    "RENDERERS",
    "RENDERER_CHOICES",
    "SECONDS_PER_PAIR",
    "InterpolationJob",
    "InterpolationPlan",
    "check_choices",
    "check_device",
    "depth_name",
    "frame_count",
    "is_rounded",
    "networks_of",
    "plan_interpolation",
    "sample_types",
    "targets",
    "with_preset",
]
